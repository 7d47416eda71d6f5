# SPDX-License-Identifier: Apache-2.0
"""The latest tactile readings and clouds by stamp, bounded in time and memory.

Stamps of tactile readings may repeat, come in the wrong order, or come from a clock that is set while it runs. A
reading whose stamp leaps is set aside until the next one shows whether the clock has jumped or one stamp was wrong;
all that follow the readings, such as tare and contact detectors, see those alone that the buffer has accepted.
After a jump back, all readings so far are discarded, since readings to come would have the same stamps.
"""

from bisect import bisect_left, bisect_right
from collections import Counter, OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Self

import numpy as np

from foretouch.cloud.messages import read_header
from foretouch.errors import CloudError, DatasetError
from foretouch.tactile import BIOTAC
from foretouch.tactile.messages.table import TactileReading
from foretouch.types import SECOND_NS, Cloud, Float32, Int64
from foretouch.types.channels import Channels
from foretouch.types.scene import Object

_MB = 1_000_000
_LEAP_NS = SECOND_NS  # a stamp further than this from the newest is a leap; a smaller step back is jitter
_TRIM_EVERY = 100  # readings; removing the front of a list takes time
_MAX_READINGS = 100_000
_TIME = attrgetter("time_ns")
_SAME_M = 1e-5  # difference of points that were rounded on their way to another frame and back


@dataclass(frozen=True, eq=False)
class TouchWindow:
    """Readings between two stamps, in the order of their stamps."""

    stamps_ns: Int64  # (T,) int64 [ns]
    counts: Float32  # (T, D) float32
    others: Float32  # (T, K) float32
    received_ns: Int64  # (T,) int64 [ns]

    def __len__(self) -> int:
        return len(self.stamps_ns)


class TouchBuffer:
    """Readings of a sensor by stamp, kept for `kept_s` [s] by their stamps, and at most 100,000. Not thread-safe.

    Besides its channels, `others` name what the readings hold. Anomalies are counted as `duplicate_stamp`, `out_of_order`, `clock_jump` (back), `stamp_gap` (a leap forward that
    stayed) and `wrong_stamp` (a leap that did not; such readings are left out).
    """

    def __init__(self, kept_s: float = 60.0, channels: Channels = BIOTAC, others: tuple[str, ...] = ()) -> None:
        self.channels = channels
        self.others = others
        self.anomalies: Counter[str] = Counter()
        self.newest_ns: int | None = None  # latest stamp [ns], None before the first
        self._kept_ns = round(kept_s * SECOND_NS)
        self._suspect: TactileReading | None = None
        self._readings: list[TactileReading] = []  # by their times

    def __len__(self) -> int:
        return len(self._readings)

    def add(self, reading: TactileReading) -> tuple[TactileReading, ...]:
        """Add a reading, in any order, and return the readings that are accepted now.

        That is this one; none while its stamp is in question; or also the one before it, whose stamp it has confirmed.
        """
        if self.newest_ns is not None and abs(reading.time_ns - self.newest_ns) > _LEAP_NS:
            return self._add_leap(reading)
        if self._suspect is not None:
            self.anomalies["wrong_stamp"] += 1
            self._suspect = None
        self._insert(reading)
        return (reading,)

    def between(self, low_ns: int, high_ns: int) -> TouchWindow:
        """Return the readings stamped in [low, high)."""
        first, end = (bisect_left(self._readings, stamp, key=_TIME) for stamp in (low_ns, high_ns))
        rows = self._readings[first:end]
        return TouchWindow(
            np.array([r.time_ns for r in rows], np.int64),
            np.array([r.counts for r in rows], np.float32).reshape(len(rows), self.channels.size),
            np.array([r.others for r in rows], np.float32).reshape(len(rows), len(self.others)),
            np.array([r.received_ns for r in rows], np.int64),
        )

    def _insert(self, reading: TactileReading) -> None:
        stamp, newest = reading.time_ns, self.newest_ns
        if newest is None or stamp > newest:
            self._readings.append(reading)
            self.newest_ns = stamp
        else:
            index = bisect_right(self._readings, stamp, key=_TIME)
            duplicate = index > 0 and self._readings[index - 1].time_ns == stamp
            self.anomalies["duplicate_stamp" if duplicate else "out_of_order"] += 1
            self._readings.insert(index, reading)
        if len(self) % _TRIM_EVERY == 0 or len(self) > _MAX_READINGS:
            self._trim()

    def _add_leap(self, reading: TactileReading) -> tuple[TactileReading, ...]:
        before, self._suspect = self._suspect, reading
        if before is None:
            return ()
        if abs(reading.time_ns - before.time_ns) > _LEAP_NS:
            self.anomalies["wrong_stamp"] += 1  # the reading before; this one is now the suspect
            return ()
        self._suspect = None
        if self.newest_ns is not None and before.time_ns < self.newest_ns:
            self.anomalies["clock_jump"] += 1
            self._readings.clear()
        else:
            self.anomalies["stamp_gap"] += 1
        self.newest_ns = self._readings[-1].time_ns if self._readings else None
        self._insert(before)
        self._insert(reading)
        return before, reading

    def _trim(self) -> None:
        old = bisect_left(self._readings, (self.newest_ns or 0) - self._kept_ns, key=_TIME)
        del self._readings[: max(old, len(self) - _MAX_READINGS)]  # at least 0


@dataclass(frozen=True, eq=False)
class SeenObjects:
    """The objects of a cloud, or a message of which they are decoded only where a sample needs them."""

    stamp_ns: int  # of the cloud [ns]
    decode: Callable[[], Sequence[Object]]  # gives them, on an assumed table where it is not known
    size: int  # in memory [bytes]
    data: bytes = b""  # the message as CDR, if it is one
    by_place: bool = False  # whether its labels differ from the grasps', so that the object of a grasp is the nearest
    since_s: float = 0.0  # when the buffer got it [s]
    ambiguous: bool = False  # whether a different cloud has the same stamp

    @classmethod
    def of(cls, objects: Sequence[Object], stamp_ns: int) -> Self:
        """Keep the points and the table of objects, and not the image that they were cut from."""
        kept = [Object.of(seen.id, _copied(seen.cloud), seen.plane) for seen in objects]
        return cls(stamp_ns, lambda: kept, sum(seen.cloud.xyz.nbytes for seen in kept))

    @classmethod
    def of_message(cls, data: bytes, decode: Callable[[], Sequence[Object]], *, by_place: bool = False) -> Self:
        """Keep a serialised message that begins with the header of the cloud; a `DatasetError` if there is none."""
        return cls(read_header(data)[0], decode, len(data), data, by_place)

    def is_same(self, other: "SeenObjects") -> bool:
        """Return whether both hold the same points in the same frame: padding in CDR is undefined, and fields may be left out."""
        if self.data and self.data == other.data:
            return True
        try:
            pairs = list(zip(self.decode(), other.decode(), strict=True))
        except (CloudError, DatasetError, ValueError):  # the last of other numbers of objects
            return False
        return all(_are_same(mine.cloud, theirs.cloud) for mine, theirs in pairs)


def _copied(cloud: Cloud) -> Cloud:
    """Return a cloud that holds no other memory than its points."""
    rgb = None if cloud.rgb is None else cloud.rgb.copy()
    return Cloud(cloud.xyz.copy(), rgb, cloud.frame_id, cloud.stamp_ns)


def _are_same(mine: Cloud, theirs: Cloud) -> bool:
    """Return whether two clouds have the same points in the same frame, but for rounding."""
    return (mine.frame_id, mine.xyz.shape) == (theirs.frame_id, theirs.xyz.shape) and np.allclose(
        mine.xyz, theirs.xyz, rtol=0.0, atol=_SAME_M, equal_nan=True
    )


class CloudBuffer:
    """The objects of clouds by stamp, at most for `kept_s` [s] and in `kept_mb` [MB]; the oldest arrival is removed first.

    Not thread-safe. A grasp asks for its cloud seconds after the hand has hidden the object.
    """

    def __init__(self, kept_s: float, kept_mb: float) -> None:
        self.bytes = 0
        self._kept_s = kept_s
        self._max_bytes = kept_mb * _MB
        self._clouds: OrderedDict[int, SeenObjects] = OrderedDict()

    def __len__(self) -> int:
        return len(self._clouds)

    def get(self, stamp_ns: int) -> SeenObjects | None:
        """Return the cloud of this stamp, None if it never came or has been removed."""
        return self._clouds.get(stamp_ns)

    def add(self, seen: SeenObjects, now_s: float) -> list[SeenObjects]:
        """Add the objects of a cloud, and return the clouds that were removed for it."""
        known = self._clouds.get(seen.stamp_ns)
        if known is not None:
            self._clouds[seen.stamp_ns] = replace(known, ambiguous=known.ambiguous or not known.is_same(seen))
            return []
        self._clouds[seen.stamp_ns] = replace(seen, since_s=now_s)
        self.bytes += seen.size
        removed = []
        while self._clouds:
            oldest = next(iter(self._clouds.values()))
            if self.bytes <= self._max_bytes and oldest.since_s >= now_s - self._kept_s:
                break
            removed.append(self._pop())
        return removed

    def clear(self) -> list[SeenObjects]:
        """Remove all clouds; gives them, oldest first."""
        return [self._pop() for _ in range(len(self._clouds))]

    def _pop(self) -> SeenObjects:
        _, cloud = self._clouds.popitem(last=False)
        self.bytes -= cloud.size
        return cloud
