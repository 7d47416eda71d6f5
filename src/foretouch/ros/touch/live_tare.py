# SPDX-License-Identifier: Apache-2.0
"""The tare of a hand at work: what its fingertips read while they touch nothing. No node, no thread.

A reading belongs to rest if neither finger is in contact, by the detector, nor will be within `lag_s`: a contact is
noticed a moment after it has begun. The tare is the median over the last `window_s` of rest; through a grasp, that from
before it stays, and ages.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from foretouch.tactile import check_touch
from foretouch.tactile.contact_detector import ContactConfig, ContactDetector
from foretouch.types import Float32, Touch

__all__ = ["LiveTare"]

_SECOND_NS = 1_000_000_000
_FEWEST = 5  # readings
_RENEW = 10  # readings between two tares: they hardly change, and a median takes time
_SPAN = 0.8  # of the window has to be there


class LiveTare:
    """Follows a stream of readings. Not thread-safe.

    Args:
        config: Of the contact detector; its `window_s` and `lag_s` are those of the tare.

    Attributes:
        fault: Why the last rest makes no tare, such as a dead sensor; "" if it does, or there was none.
    """

    def __init__(self, config: ContactConfig) -> None:
        self.fault = ""
        self._detector = ContactDetector(config)
        self._lag_ns = round(config.lag_s * _SECOND_NS)
        self._window_ns = round(config.window_s * _SECOND_NS)
        self._recent: deque[tuple[int, Float32]] = deque()
        self._rest: list[Float32] = []
        self._rest_ns = 0
        self._taken_s = 0.0
        self._tare: Touch | None = None
        self._since_renewal = 0

    def update(self, stamp_ns: int, counts: Float32, now_s: float) -> None:
        """Take a reading.

        Args:
            stamp_ns: Of the reading [ns].
            counts: (50,) as `Touch.vector()`.
            now_s: By a clock that never goes back [s].
        """
        self._detector.update(stamp_ns, counts)
        touching = [finger.touching for finger in self._detector.fingers.values()]
        if any(touching):
            self._recent.clear()  # the last of it may belong to the contact; what was rest before that is kept
            return
        self._recent.append((stamp_ns, counts))
        oldest = stamp_ns - self._lag_ns - self._window_ns
        while self._recent[0][0] < oldest:
            self._recent.popleft()
        self._since_renewal += 1
        if self._since_renewal >= _RENEW and None not in touching:
            self._renew(stamp_ns, now_s)

    def tare(self, now_s: float, max_age_s: float) -> Touch | None:
        """The median of the last rest; None if there is none that is fresh, or its sensors do not work."""
        if self.age_s(now_s) > max_age_s:
            return None
        if self._tare is None and not self.fault:
            touch = Touch.from_vector(np.median(self._rest, axis=0))
            self.fault = "; ".join(check_touch(touch).faults)
            self._tare = None if self.fault else touch
        return self._tare

    def age_s(self, now_s: float) -> float:
        """Time since the last rest [s]; infinite if there was none."""
        return now_s - self._taken_s if self._rest else float("inf")

    def held(self, contact_ns: int, release_ns: int) -> None:
        """A grasp was told of: what was taken for rest during it was none, such as where the stream began in contact.

        Args:
            contact_ns: When contact was steady [ns].
            release_ns: When the hand began to open [ns].
        """
        if self._rest and contact_ns <= self._rest_ns < release_ns:
            self.forget()

    def forget(self) -> None:
        """Begin anew: the clock has jumped, or what was taken for rest was none."""
        self._detector.forget()
        self._recent.clear()
        self._rest, self._tare, self.fault = [], None, ""

    def _renew(self, stamp_ns: int, now_s: float) -> None:
        newest = stamp_ns - self._lag_ns
        rest = [counts for stamp, counts in self._recent if stamp <= newest]
        spans = newest - self._recent[0][0] >= _SPAN * self._window_ns
        if len(rest) >= _FEWEST and spans:
            self._rest, self._rest_ns, self._taken_s = rest, newest, now_s - self._lag_ns / _SECOND_NS
            self._tare, self.fault, self._since_renewal = None, "", 0
