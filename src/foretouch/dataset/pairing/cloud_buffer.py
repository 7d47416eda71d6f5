# SPDX-License-Identifier: Apache-2.0
"""The latest clouds as they came, by stamp: a grasp asks for its cloud seconds after the hand has hidden the object."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

__all__ = ["BufferedCloud", "CloudBuffer"]

_MB = 1_000_000


@dataclass(frozen=True, eq=False)
class BufferedCloud:
    """A serialised cloud.

    Attributes:
        stamp_ns: Of its header [ns].
        data: The message.
        kept_since_s: By the clock of whoever keeps it [s].
        ambiguous: Whether another cloud came with the same stamp.
    """

    stamp_ns: int
    data: bytes
    kept_since_s: float
    ambiguous: bool = False


class CloudBuffer:
    """Clouds by stamp, bounded in time and in memory; the oldest arrival goes first. Not thread-safe.

    Args:
        kept_s: How long a cloud is kept [s].
        kept_mb: Most memory [MB].

    Attributes:
        bytes: Memory that is taken.
    """

    def __init__(self, kept_s: float, kept_mb: float) -> None:
        self.bytes = 0
        self._kept_s = kept_s
        self._most = kept_mb * _MB
        self._clouds: OrderedDict[int, BufferedCloud] = OrderedDict()

    def __len__(self) -> int:
        return len(self._clouds)

    def get(self, stamp_ns: int) -> BufferedCloud | None:
        """The cloud of this stamp, None where it is not kept (any more)."""
        return self._clouds.get(stamp_ns)

    def add(self, stamp_ns: int, data: bytes, now_s: float) -> list[BufferedCloud]:
        """Keep a cloud.

        Args:
            stamp_ns: Of its header [ns].
            data: The message; not copied.
            now_s: By a clock that never goes back [s].

        Returns:
            Those that are given up for it.
        """
        known = self._clouds.get(stamp_ns)
        if known is not None:
            self._clouds[stamp_ns] = replace(known, ambiguous=known.ambiguous or known.data != data)
            return []
        self._clouds[stamp_ns] = BufferedCloud(stamp_ns, data, now_s)
        self.bytes += len(data)
        gone = []
        while self._clouds and (self.bytes > self._most or self._oldest.kept_since_s < now_s - self._kept_s):
            gone.append(self._pop())
        return gone

    def clear(self) -> list[BufferedCloud]:
        """Give up all, oldest first."""
        return [self._pop() for _ in range(len(self._clouds))]

    @property
    def _oldest(self) -> BufferedCloud:
        return next(iter(self._clouds.values()))

    def _pop(self) -> BufferedCloud:
        _, cloud = self._clouds.popitem(last=False)
        self.bytes -= len(cloud.data)
        return cloud
