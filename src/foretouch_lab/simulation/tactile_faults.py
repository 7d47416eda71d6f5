# SPDX-License-Identifier: Apache-2.0
"""Faults of tactile messages and of fingers, for robustness tests."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from foretouch.camera.message_faults import FaultConfig, MessageFaults
from foretouch.config import setting

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class TactileFaultConfig(FaultConfig):
    """Faults of messages, and of the fingers."""

    swapped: bool = setting(False, "Whether the readings of thumb and middle finger are exchanged")
    frozen: str = setting(
        "",
        "Finger whose readings stay the same: TH, which takes g1, or MF, which takes g2; empty for none",
        choices=("", "TH", "MF"),
    )


class TactileFaults(MessageFaults):
    """As `MessageFaults`, for tactile messages."""

    config: TactileFaultConfig

    def __init__(self, config: TactileFaultConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._first: dict[str, Any] = {}

    def readings(self, fingers: Mapping[str, _T]) -> dict[str, _T]:
        """The readings that a message carries, by finger: of the wrong one, or those of the first message."""
        found, frozen = dict(fingers), self.config.frozen
        if frozen:
            found[frozen] = self._first.setdefault(frozen, found[frozen])
        if self.config.swapped:
            found["TH"], found["MF"] = found["MF"], found["TH"]
        return found
