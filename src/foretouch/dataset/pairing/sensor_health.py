# SPDX-License-Identifier: Apache-2.0
"""Whether the fingertips are alive: told finger by finger, while the stream goes on."""

from __future__ import annotations

from foretouch.tactile import FULL_SCALE, check_touch
from foretouch.tactile.contact_detector import FINGER_COLUMNS
from foretouch.tactile.validity import CONSTANT_SAMPLES
from foretouch.types import Float32, Touch

__all__ = ["ALIVE", "NO_DATA", "SensorHealth"]

ALIVE = "alive"
NO_DATA = "no data"
_FROZEN_SAMPLES = 200  # the same 25 noisy counts over and over: the driver repeats an old message


class SensorHealth:
    """The state of thumb and middle finger. Not thread-safe.

    Args:
        constant: From how many readings with the same PDC on a sensor is dead (see `tactile.check_series`).
        frozen: Likewise, from how many identical readings on the stream is frozen.

    Attributes:
        states: By finger: `alive`, `no data`, or what is wrong.
    """

    def __init__(self, constant: int = CONSTANT_SAMPLES, frozen: int = _FROZEN_SAMPLES) -> None:
        self.states = dict.fromkeys(FINGER_COLUMNS, NO_DATA)
        self._constant = constant
        self._frozen = frozen
        self._last: dict[str, Float32] = {}
        self._same = dict.fromkeys(FINGER_COLUMNS, 0)
        self._same_pdc = dict.fromkeys(FINGER_COLUMNS, 0)

    def update(self, counts: Float32) -> None:
        """Take a reading, (50,) as `Touch.vector()`."""
        plausible = float(counts.min()) > 0.0 and float(counts.max()) <= FULL_SCALE
        faults = () if plausible else check_touch(Touch.from_vector(counts)).faults
        for finger, place in FINGER_COLUMNS.items():
            mine = counts[place]
            self._count(finger, mine)
            broken = [fault for fault in faults if fault.partition(":")[0].partition("[")[0].endswith(finger.lower())]
            self.states[finger] = broken[0] if broken else self._judge(finger, mine)

    def silence(self) -> None:
        """Nothing has come for a while."""
        self.states = dict.fromkeys(FINGER_COLUMNS, NO_DATA)

    def _count(self, finger: str, mine: Float32) -> None:
        last = self._last.get(finger)
        same_pdc = last is not None and last[0] == mine[0]
        self._same_pdc[finger] = self._same_pdc[finger] + 1 if same_pdc else 0
        self._same[finger] = self._same[finger] + 1 if last is not None and (last == mine).all() else 0
        self._last[finger] = mine

    def _judge(self, finger: str, mine: Float32) -> str:
        if self._same[finger] >= self._frozen:
            return f"frozen: the same {self._same[finger] + 1} times"
        if self._same_pdc[finger] >= self._constant:
            return f"dead: PDC constant at {mine[0]:g} over {self._same_pdc[finger] + 1} readings"
        return ALIVE
