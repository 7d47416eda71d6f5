# SPDX-License-Identifier: Apache-2.0
"""What the fingertips read in executed grasps, cut out of the stream of tactile messages by header stamps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from foretouch.errors import TactileError
from foretouch.ros.messages.conversions import stamp_ns
from foretouch.ros.messages.tactile import counts_from_msg
from foretouch.tactile import make_tare
from foretouch.types import Touch
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp

__all__ = ["Felt", "TactileWindow"]

_KEPT = 1500  # messages: 15 s at 100 Hz, longer than a grasp
_TARE_NS = 300_000_000  # before the hand begins to close


@dataclass(frozen=True, eq=False)
class Felt:
    """One executed grasp.

    Attributes:
        grasp_id: Of the grasp.
        touch: Median over the steady contact.
        tare: Median over the time just before the hand closed.
    """

    grasp_id: str
    touch: Touch
    tare: Touch


class TactileWindow:
    """The latest tactile messages. Not thread-safe: whoever fills it asks it."""

    def __init__(self) -> None:
        self._messages: deque[tuple[int, BiotacAll]] = deque(maxlen=_KEPT)

    def add(self, message: BiotacAll) -> None:
        """Keep a message."""
        self._messages.append((stamp_ns(message.header.stamp), message))

    def felt(self, report: ExecutedGrasp) -> Felt | None:
        """What was read in a grasp; None if it failed, or the messages are gone or no readings."""
        start, contact, release = (stamp_ns(t) for t in (report.start, report.contact, report.release))
        if not report.success:
            return None
        try:
            touch, tare = make_tare(self._between(contact, release)), make_tare(self._between(start - _TARE_NS, start))
        except TactileError:
            return None
        return Felt(report.grasp_id, touch, tare)

    def _between(self, low_ns: int, high_ns: int) -> list[Touch]:
        return [_touch(message) for stamp, message in self._messages if low_ns <= stamp < high_ns]


def _touch(message: Any) -> Touch:
    thumb, middle = (counts_from_msg(message, name).astype(np.float64) for name in ("TH", "MF"))
    return Touch(float(thumb[0]), float(middle[0]), thumb[1:], middle[1:])
