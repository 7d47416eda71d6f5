# SPDX-License-Identifier: Apache-2.0
"""Faults of messages between a sensor and its subscribers (loss, jitter, duplicates), for robustness tests."""

from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting


@dataclass(frozen=True, kw_only=True)
class FaultConfig(Settings):
    """Faults that are put in on purpose; by default there are none."""

    jitter_s: float = setting(0.0, "Largest error of a stamp, to either side", bounds=(0.0, 10.0))
    skew_s: float = setting(0.0, "How much the sensor's clock is ahead of the robot's", bounds=(-3600.0, 3600.0))
    drop_share: float = setting(0.0, "Part of the messages that are not sent", bounds=(0.0, 1.0))


class MessageFaults:
    """Spoils stamps and takes messages away, and counts both.

    Attributes:
        config: May be replaced at any time.
        passed: Messages that were let through.
        dropped: Messages that were taken away.
        moved: Messages let through whose stamp is not the true one.
    """

    def __init__(self, config: FaultConfig, seed: int = 0) -> None:
        self.config = config
        self._rng = np.random.default_rng(seed)
        self.passed = self.dropped = self.moved = 0

    def stamp(self, true_ns: int) -> int | None:
        """The stamp that a message carries, or None for one that is lost.

        Both draws are made for every message, so that one fault does not move the other's numbers.

        Args:
            true_ns: When it was measured [ns].
        """
        fate, error = self._rng.random(), self._rng.uniform(-1.0, 1.0)
        if fate < self.config.drop_share:
            self.dropped += 1
            return None
        shift_ns = round((self.config.skew_s + self.config.jitter_s * error) * 1e9)
        self.passed += 1
        self.moved += shift_ns != 0
        return max(0, true_ns + shift_ns)
