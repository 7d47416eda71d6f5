# SPDX-License-Identifier: Apache-2.0
"""The tare of a hand: its readings while it touches nothing. No node, no thread.

A reading is at rest if neither finger is in contact, by the contact detector, nor will be within `LAG_S`: a contact is
detected a moment after it has begun. The tare is the median over the last `WINDOW_S` of rest, and 0 for channels whose rest level is zero; during a grasp, the tare
from before is kept, and ages.
"""

from collections import deque

import numpy as np

from foretouch.tactile import BIOTAC, touch_faults
from foretouch.tactile.contact_detector import LAG_S, WINDOW_S, ContactDetector
from foretouch.tactile.readings import rest_of
from foretouch.types import SECOND_NS, Float32, Touch
from foretouch.types.channels import Channels


class LiveTare:
    """The tare of a stream of readings of a sensor. Not thread-safe."""

    def __init__(self, channels: Channels = BIOTAC) -> None:
        self.fault = ""  # why the last rest gives no tare, such as a dead sensor
        self._channels = channels
        self._detector = ContactDetector(channels)
        self._lag_ns, self._window_ns = round(LAG_S * SECOND_NS), round(WINDOW_S * SECOND_NS)
        # Far more than the window and the lag hold at any rate; stamps that repeat would fill the memory.
        self._recent: deque[tuple[int, Float32]] = deque(maxlen=20_000)
        self._rest: list[Float32] = []
        self._rest_ns = 0
        self._rest_s = 0.0
        self._tare: Touch | None = None
        self._since_renewal = 0

    def update(self, stamp_ns: int, counts: Float32, now_s: float) -> None:
        """Add a reading (D,), as `Touch.values`, whose stamp [ns] the `TouchBuffer` has accepted.

        `now_s` is the time of a clock that never goes back [s].
        """
        self._detector.update(stamp_ns, counts)
        touching = [finger.touching for finger in self._detector.fingers.values()]
        if any(touching):
            self._recent.clear()  # its end may belong to the contact; the rest before it is kept
            return
        self._recent.append((stamp_ns, counts))
        while self._recent[0][0] < stamp_ns - self._lag_ns - self._window_ns:
            self._recent.popleft()
        self._since_renewal += 1
        if self._since_renewal >= 10 and None not in touching:  # the tare hardly changes, and a median takes time
            self._renew(stamp_ns, now_s)

    def tare(self, now_s: float, max_age_s: float) -> Touch | None:
        """Return the median of the last rest; None if there is no recent one, or a sensor does not work."""
        if self.age_s(now_s) > max_age_s:
            return None
        if self._tare is None and not self.fault:
            touch = rest_of(np.median(self._rest, axis=0), self._channels)
            self.fault = "; ".join(touch_faults(touch))
            self._tare = None if self.fault else touch
        return self._tare

    def age_s(self, now_s: float) -> float:
        """Return the time since the last rest [s]; infinite if there was none."""
        return now_s - self._rest_s if self._rest else float("inf")

    def exclude(self, contact_ns: int, release_ns: int) -> None:
        """Reset a tare from within a reported grasp [ns, ns), such as where the stream began in contact."""
        if self._rest and contact_ns <= self._rest_ns < release_ns:
            self.reset()

    def reset(self) -> None:
        """Restart, after the clock has jumped or a contact was taken for rest."""
        self._detector.reset()
        self._recent.clear()
        self._rest = []
        self._tare = None
        self.fault = ""

    def _renew(self, stamp_ns: int, now_s: float) -> None:
        newest = stamp_ns - self._lag_ns
        rest = [counts for stamp, counts in self._recent if stamp <= newest]
        if len(rest) >= 5 and newest - self._recent[0][0] >= 0.8 * self._window_ns:
            self._rest = rest
            self._rest_ns = newest
            self._rest_s = now_s - self._lag_ns / SECOND_NS
            self._tare = None
            self.fault = ""
            self._since_renewal = 0
