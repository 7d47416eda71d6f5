# SPDX-License-Identifier: Apache-2.0
"""Faults of tactile messages between the hand and its subscribers, for robustness tests: by default none."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from foretouch.config import Settings, setting

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class FaultConfig(Settings):
    """Faults that are put in on purpose."""

    jitter_s: float = setting(0.0, "Largest error of a stamp, to either side", bounds=(0.0, 10.0))
    skew_s: float = setting(0.0, "How much the sensor's clock is ahead of the robot's", bounds=(-3600.0, 3600.0))
    drop_share: float = setting(0.0, "Part of the messages that are not sent", bounds=(0.0, 1.0))
    swapped: bool = setting(False, "Whether the readings of thumb and middle finger are exchanged")
    frozen: str = setting(
        "",
        "Finger whose readings stay the same: TH, which takes g1, or MF, which takes g2; empty for none",
        choices=("", "TH", "MF"),
    )


class MessageFaults:
    """Spoils stamps and readings and takes messages away; counts those `passed`, `dropped`, and passed with a `moved` stamp.

    `config` may be replaced at any time.
    """

    def __init__(self, config: FaultConfig, seed: int = 0) -> None:
        self.config = config
        self._rng = np.random.default_rng(seed)
        self.passed = self.dropped = self.moved = 0
        self._first: dict[str, Any] = {}

    def stamp(self, true_ns: int) -> int | None:
        """Return the stamp of a message that was measured at a time [ns], or None for one that is lost.

        Both draws are made for every message, so that one fault does not move the other's numbers.
        """
        fate, error = self._rng.random(), self._rng.uniform(-1.0, 1.0)
        if fate < self.config.drop_share:
            self.dropped += 1
            return None
        shift_ns = round((self.config.skew_s + self.config.jitter_s * error) * 1e9)
        self.passed += 1
        self.moved += shift_ns != 0
        return max(0, true_ns + shift_ns)

    def readings(self, fingers: Mapping[str, _T]) -> dict[str, _T]:
        """Return the readings that a message carries, by finger: of the wrong finger, or of the first message."""
        sent, frozen = dict(fingers), self.config.frozen
        if frozen:
            sent[frozen] = self._first.setdefault(frozen, sent[frozen])
        if self.config.swapped:
            sent["TH"], sent["MF"] = sent["MF"], sent["TH"]
        return sent
