# SPDX-License-Identifier: Apache-2.0
"""A bounded queue between threads that counts every item it drops."""

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import Generic, Literal, TypeVar

_Item = TypeVar("_Item")


class BoundedQueue(Generic[_Item]):
    """First in, first out; thread-safe.

    Args:
        capacity: Sum of the sizes of the items that may wait; None for no limit.
        when_full: `drop_oldest` makes room for the new item, `reject` drops the new item, `wait` blocks its sender.
        size_of: Size of an item, such as its bytes; None counts each item as 1.
        on_drop: Called with each dropped item and the reason. The queue is locked meanwhile: return at once.
    """

    def __init__(
        self,
        capacity: int | None,
        *,
        when_full: Literal["drop_oldest", "reject", "wait"] = "drop_oldest",
        size_of: Callable[[_Item], int] | None = None,
        on_drop: Callable[[_Item, str], None] | None = None,
    ) -> None:
        self.capacity = capacity  # may be changed at any time
        self.dropped: Counter[str] = Counter()  # as `superseded`, `full`, `closed`, or what `close` was given
        self._when_full = when_full
        self._size_of = size_of or (lambda _: 1)
        self._on_drop = on_drop
        self._changed = threading.Condition()
        self._items: deque[_Item] = deque()
        self._size = 0
        self._closed_reason = ""

    def put(self, item: _Item) -> bool:
        """Append an item; False if it was dropped."""
        size = self._size_of(item)
        with self._changed:
            if self._when_full == "wait":
                self._changed.wait_for(lambda: self._closed_reason or self._has_room(size))
            elif self._when_full == "drop_oldest":
                while self._items and not self._has_room(size):
                    self._drop(self._pop(), "superseded")
            if self._closed_reason or not self._has_room(size):
                self._drop(item, self._closed_reason or "full")
                return False
            self._items.append(item)
            self._size += size
            self._changed.notify_all()
            return True

    def get(self, timeout_s: float | None = None) -> _Item | None:
        """Remove and return the oldest item; None if there was none in time, or the queue is closed and empty."""
        with self._changed:
            self._wait(timeout_s)
            return self._pop() if self._items else None

    def get_all(self, timeout_s: float | None = None) -> list[_Item]:
        """Remove and return all items, after waiting for the first as `get` does."""
        with self._changed:
            self._wait(timeout_s)
            return [self._pop() for _ in range(len(self._items))]

    def close(self, discard: str = "", then: str = "") -> None:
        """Drop what is put from now on and release blocked threads.

        Args:
            discard: Why the items are dropped, too; "" keeps them.
            then: Why items are dropped from now on; by default as the items, or `closed`.
        """
        with self._changed:
            self._closed_reason = then or discard or "closed"
            while discard and self._items:
                self._drop(self._pop(), discard)
            self._changed.notify_all()

    def open(self) -> None:
        """Take items again after `close`."""
        with self._changed:
            self._closed_reason = ""

    @property
    def closed(self) -> bool:
        """Whether new items are dropped because of `close`."""
        return bool(self._closed_reason)

    def _has_room(self, size: int) -> bool:
        return self.capacity is None or self._size + size <= self.capacity

    def _wait(self, timeout_s: float | None) -> None:
        self._changed.wait_for(lambda: self._items or self._closed_reason, timeout_s)

    def _pop(self) -> _Item:
        item = self._items.popleft()
        self._size -= self._size_of(item)
        self._changed.notify_all()
        return item

    def _drop(self, item: _Item, reason: str) -> None:
        self.dropped[reason] += 1
        if self._on_drop is not None:
            self._on_drop(item, reason)
