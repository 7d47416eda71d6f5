# SPDX-License-Identifier: Apache-2.0
"""Slow work beside callbacks: these only store, and the newest input comes next.

So a `SingleThreadedExecutor` of rclpy serves a whole graph.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

_T = TypeVar("_T")


class Worker(Generic[_T]):
    """Calls a function with one item after the other in a thread of its own.

    Args:
        name: Of the thread.
        work: Called with each item; must not raise.
        on_drop: Called with each item that is dropped and the reason, `superseded` or `stopped`.
        depth: Number of items that may wait; a further one replaces the oldest.
    """

    def __init__(
        self, name: str, work: Callable[[_T], None], on_drop: Callable[[_T, str], None], depth: int = 1
    ) -> None:
        self._name, self._work, self._on_drop, self._depth = name, work, on_drop, depth
        self._changed = threading.Condition()
        self._waiting: deque[_T] = deque()
        self._thread: threading.Thread | None = None  # while it is started

    def start(self) -> None:
        """Start the thread, unless it runs."""
        with self._changed:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()

    def put(self, item: _T) -> None:
        """Let an item wait for its turn, in place of the oldest one where too many wait."""
        with self._changed:
            dropped = [] if self._thread is not None else [(item, "stopped")]
            if self._thread is not None:
                if len(self._waiting) == self._depth:
                    dropped.append((self._waiting.popleft(), "superseded"))
                self._waiting.append(item)
                self._changed.notify()
        for each in dropped:
            self._on_drop(*each)

    def stop(self) -> None:
        """Drop what waits, finish the current item and end the thread."""
        with self._changed:
            thread, self._thread = self._thread, None
            dropped = list(self._waiting)
            self._waiting.clear()
            self._changed.notify_all()
        for item in dropped:
            self._on_drop(item, "stopped")
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        current = threading.current_thread()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._thread is not current)
                if self._thread is not current:
                    return
                item = self._waiting.popleft()
            self._work(item)
