# SPDX-License-Identifier: Apache-2.0
"""Slow work beside callbacks: these only store, and the newest input comes next.

So a `SingleThreadedExecutor` of rclpy serves a whole graph.
"""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from foretouch.bounded_queue import BoundedQueue

_T = TypeVar("_T")


class Worker(Generic[_T]):
    """Calls a function with one item after the other in one thread.

    Args:
        name: Of the thread.
        work: Called with each item.
        on_error: Called with each error of `work`, which goes on with the next item.
        on_drop: Called with each item that is dropped and the reason, `superseded`, `stopped` or `idle`; must return at once.
        depth: Number of items that may wait; a further one replaces the oldest.
        idle: Why items are dropped that come while it is not started.

    Attributes:
        put: Lets an item wait for its turn, in place of the oldest one where too many wait.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[_T], None],
        on_error: Callable[[Exception], object],
        on_drop: Callable[[_T, str], None],
        depth: int = 1,
        idle: str = "stopped",
    ) -> None:
        self._name = name
        self._work = work
        self._on_error = on_error
        self._idle = idle
        self._queue = BoundedQueue[_T](depth, on_drop=on_drop)
        self._queue.close(then=idle)
        self.put = self._queue.put
        self._thread: threading.Thread | None = None  # while it is started

    def start(self) -> None:
        """Start the thread, unless it runs."""
        if self._thread is None:
            self._queue.open()
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Drop what waits, finish the current item and end the thread."""
        self._queue.close("stopped", self._idle)
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                self._work(item)
            except Exception as err:  # noqa: BLE001  it would end the thread
                self._on_error(err)
