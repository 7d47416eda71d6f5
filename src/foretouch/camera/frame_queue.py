# SPDX-License-Identifier: Apache-2.0
"""Frames on their way from a thread of the library to the reader.

Not the library's own `frame_queue`: from Python it is filled while its thread holds the interpreter
lock, so a full queue that waits for its reader (a recording read at the reader's pace) never ends.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Generic, TypeVar

__all__ = ["FrameQueue"]

_Item = TypeVar("_Item")


class FrameQueue(Generic[_Item]):
    """A queue between two threads, of bounded length once `bound` is called.

    Args:
        capacity: Its length.
        lossless: Whether a full box makes the sender wait; if not, the oldest item makes room.
    """

    def __init__(self, capacity: int, *, lossless: bool) -> None:
        self._items: deque[_Item] = deque()
        self._capacity = capacity
        self._lossless = lossless
        self._bounded = self._closed = False
        self._changed = threading.Condition()

    def put(self, item: _Item) -> None:
        """Leave an item; once closed, it is thrown away."""
        with self._changed:
            if self._lossless:
                self._changed.wait_for(lambda: self._closed or not self._full())
            elif self._full():
                self._items.popleft()
            if not self._closed:
                self._items.append(item)
                self._changed.notify_all()

    def get(self, timeout_s: float) -> _Item | None:
        """The oldest item, or None if none came in time."""
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while not self._items:
                left = deadline - time.monotonic()
                if left <= 0.0 or not self._changed.wait(left):
                    break
            if not self._items:
                return None
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    def bound(self) -> None:
        """From now on heed the capacity. Until then the library must not wait: it may be starting a stream."""
        with self._changed:
            self._bounded = True

    def close(self) -> None:
        """Let a waiting sender go, and forget the items."""
        with self._changed:
            self._closed = True
            self._items.clear()
            self._changed.notify_all()

    def _full(self) -> bool:
        return self._bounded and len(self._items) >= self._capacity
