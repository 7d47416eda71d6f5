# SPDX-License-Identifier: Apache-2.0
"""Messages of several topics that belong to one cloud, brought together by their exact stamp.

Every output keeps the stamp of its cloud, so equal stamps mean the same cloud and no tolerance is
needed. The number of clouds that wait for a message is bounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

__all__ = ["StampPairing", "StampedSet"]


class StampedSet(NamedTuple):
    """Messages by topic, all of one stamp, and when the first of them arrived [s]."""

    messages: dict[str, Any]
    arrived: float


class StampPairing:
    """Collects one message a topic for each stamp. Not thread-safe.

    Args:
        topics: Names of those that make a set.
        depth: Sets that may be incomplete at a time.
        on_open: Called for the first message of each set; what it gives is kept with the set.
        on_drop: Called with a reason for each set given up: `unpaired` (pushed out by newer ones) or
            `repeated_stamp` (a topic sent a stamp twice; the first is given up).
    """

    def __init__(
        self, topics: Sequence[str], depth: int, on_open: Callable[[], float], on_drop: Callable[[str], None]
    ) -> None:
        self._topics = frozenset(topics)
        self._depth = depth
        self._on_open = on_open
        self._on_drop = on_drop
        self._waiting: dict[int, StampedSet] = {}

    def __len__(self) -> int:
        """Incomplete sets."""
        return len(self._waiting)

    def add(self, topic: str, stamp_ns: int, message: Any) -> StampedSet | None:
        """Take one message; the set of its stamp, if that is now complete.

        Args:
            topic: Where it came from.
            stamp_ns: Its stamp [ns].
            message: Whatever is to be handed over.
        """
        found = self._waiting.get(stamp_ns)
        if found is not None and topic in found.messages:
            del self._waiting[stamp_ns]
            self._on_drop("repeated_stamp")
            found = None
        if found is None:
            found = self._waiting[stamp_ns] = StampedSet({}, self._on_open())
        found.messages[topic] = message
        if found.messages.keys() == self._topics:
            return self._waiting.pop(stamp_ns)
        if len(self._waiting) > self._depth:
            del self._waiting[next(iter(self._waiting))]
            self._on_drop("unpaired")
        return None

    def clear(self, reason: str) -> None:
        """Give up all that waits."""
        while self._waiting:
            self._waiting.popitem()
            self._on_drop(reason)
