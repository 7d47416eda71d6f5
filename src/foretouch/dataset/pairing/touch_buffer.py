# SPDX-License-Identifier: Apache-2.0
"""The latest tactile readings in the order of their stamps, for as long as a grasp may ask for them.

Stamps come as they please: twice, in the wrong order, from a clock that is set while it runs. A reading that leaps
is set aside until the next one shows whether the clock has jumped or one stamp was wrong. After a jump back, all that
was kept is forgotten, since its stamps would be those of readings to come.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.types import Float32

__all__ = ["TouchBuffer", "TouchReading", "TouchWindow"]

_SECOND_NS = 1_000_000_000
_TRIM_EVERY = 100  # readings; to cut a list at its front takes time


@dataclass(frozen=True, eq=False)
class TouchReading:
    """One message of the hand.

    Attributes:
        stamp_ns: Of its header [ns].
        counts: (50,) float32: PDC_TH, PDC_MF, E_TH, E_MF [counts].
        others: (K,) float32, further channels, the same K in all readings.
        arrived_ns: When the middleware received it [ns].
    """

    stamp_ns: int
    counts: Float32
    others: Float32
    arrived_ns: int


@dataclass(frozen=True, eq=False)
class TouchWindow:
    """Readings between two stamps, in their order.

    Attributes:
        stamps_ns: (T,) int64 [ns].
        counts: (T, 50) float32.
        others: (T, K) float32.
        arrived_ns: (T,) int64 [ns].
    """

    stamps_ns: npt.NDArray[np.int64]
    counts: Float32
    others: Float32
    arrived_ns: npt.NDArray[np.int64]

    def between(self, low_ns: int, high_ns: int) -> TouchWindow:
        """Those stamped in [low, high)."""
        first, last = np.searchsorted(self.stamps_ns, (low_ns, high_ns))
        rows = slice(int(first), int(last))
        return TouchWindow(self.stamps_ns[rows], self.counts[rows], self.others[rows], self.arrived_ns[rows])

    def __len__(self) -> int:
        return len(self.stamps_ns)


class TouchBuffer:
    """Readings by stamp, bounded in time and in number. Not thread-safe.

    Args:
        kept_s: How far back it remembers [s].
        leap_s: A stamp so far from the newest is a leap [s]; less, and in the wrong order, is jitter.
        most: Readings that are kept at most.

    Attributes:
        oddities: How often each came: `duplicate_stamp`, `out_of_order`, `clock_jump` (back), `stamp_gap` (a leap
            forward that stayed), `wrong_stamp` (a leap that did not; such readings are left out).
        newest_ns: Latest stamp, None before the first.
    """

    def __init__(self, kept_s: float = 60.0, leap_s: float = 1.0, most: int = 100_000) -> None:
        self.oddities: Counter[str] = Counter()
        self.newest_ns: int | None = None
        self._kept_ns = round(kept_s * _SECOND_NS)
        self._leap_ns = round(leap_s * _SECOND_NS)
        self._most = most
        self._suspect: TouchReading | None = None
        self._stamps: list[int] = []
        self._readings: list[TouchReading] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, reading: TouchReading) -> None:
        """Take a reading, in whatever order it comes."""
        if self.newest_ns is not None and abs(reading.stamp_ns - self.newest_ns) > self._leap_ns:
            self._leap(reading)
            return
        self._drop_suspect()
        self._insert(reading)

    def between(self, low_ns: int, high_ns: int) -> TouchWindow:
        """What is kept of [low, high)."""
        rows = self._readings[bisect_left(self._stamps, low_ns) : bisect_left(self._stamps, high_ns)]
        width = len(rows[0].others) if rows else 0
        return TouchWindow(
            np.array([r.stamp_ns for r in rows], np.int64),
            np.array([r.counts for r in rows], np.float32).reshape(len(rows), 50),
            np.array([r.others for r in rows], np.float32).reshape(len(rows), width),
            np.array([r.arrived_ns for r in rows], np.int64),
        )

    def _insert(self, reading: TouchReading) -> None:
        stamp, newest = reading.stamp_ns, self.newest_ns
        if newest is None or stamp > newest:
            self._stamps.append(stamp)
            self._readings.append(reading)
            self.newest_ns = stamp
        else:
            place = bisect_right(self._stamps, stamp)
            known = place > 0 and self._stamps[place - 1] == stamp
            self.oddities["duplicate_stamp" if known else "out_of_order"] += 1
            self._stamps.insert(place, stamp)
            self._readings.insert(place, reading)
        if len(self._stamps) % _TRIM_EVERY == 0 or len(self._stamps) > self._most:
            self._trim()

    def _leap(self, reading: TouchReading) -> None:
        before, self._suspect = self._suspect, reading
        if before is None:
            return
        if abs(reading.stamp_ns - before.stamp_ns) > self._leap_ns:
            self.oddities["wrong_stamp"] += 1  # the one before; this one is now the suspect
            return
        self._suspect = None
        if self.newest_ns is not None and before.stamp_ns < self.newest_ns:
            self.oddities["clock_jump"] += 1
            self._stamps.clear()
            self._readings.clear()
        else:
            self.oddities["stamp_gap"] += 1
        self.newest_ns = self._stamps[-1] if self._stamps else None
        self._insert(before)
        self._insert(reading)

    def _drop_suspect(self) -> None:
        if self._suspect is not None:
            self.oddities["wrong_stamp"] += 1
            self._suspect = None

    def _trim(self) -> None:
        keep = bisect_left(self._stamps, (self.newest_ns or 0) - self._kept_ns)
        keep = max(keep, len(self._stamps) - self._most)
        if keep > 0:
            del self._stamps[:keep], self._readings[:keep]
