# SPDX-License-Identifier: Apache-2.0
"""Messages of several topics that belong to one cloud, brought together by their exact stamp.

Every output keeps the stamp of its cloud, so equal stamps mean the same cloud and no tolerance is
needed. The number of clouds that wait for a message is bounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

__all__ = ["StampPairing"]


class StampPairing:
    """Collects one message a topic for each stamp. Not thread-safe: feed it from one callback group.

    Args:
        topics: Names of those that make a set.
        depth: Sets that may be incomplete at a time.
        on_drop: Called with a reason for each set given up: `unpaired` (pushed out by newer ones) or
            `repeated_stamp` (a topic sent a stamp twice; the first is given up).
    """

    def __init__(self, topics: Sequence[str], depth: int, on_drop: Callable[[str], None]) -> None:
        self._topics = frozenset(topics)
        self._depth = depth
        self._on_drop = on_drop
        self._waiting: dict[int, dict[str, Any]] = {}

    def __len__(self) -> int:
        """Incomplete sets."""
        return len(self._waiting)

    def add(self, topic: str, stamp_ns: int, message: Any) -> tuple[bool, dict[str, Any] | None]:
        """Take one message.

        Args:
            topic: Where it came from.
            stamp_ns: Its stamp [ns].
            message: Whatever is to be handed over.

        Returns:
            Whether it opened a new set, and the set by topic where it is now complete.
        """
        found = self._waiting.get(stamp_ns)
        if found is not None and topic in found:
            del self._waiting[stamp_ns]
            self._on_drop("repeated_stamp")
            found = None
        opened = found is None
        group = self._waiting.setdefault(stamp_ns, {})
        group[topic] = message
        if group.keys() == self._topics:
            return opened, self._waiting.pop(stamp_ns)
        while len(self._waiting) > self._depth:
            del self._waiting[next(iter(self._waiting))]
            self._on_drop("unpaired")
        return opened, None

    def clear(self, reason: str) -> None:
        """Give up all that waits."""
        while self._waiting:
            self._waiting.popitem()
            self._on_drop(reason)
