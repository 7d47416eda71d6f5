# SPDX-License-Identifier: Apache-2.0
"""Slow work beside callbacks: these only store, and the newest input comes next.

So a `SingleThreadedExecutor` of rclpy serves a whole graph.
"""

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from foretouch.base.bounded_queue import BoundedQueue

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
        self._since: float | None = None  # when the current item was begun, `time.monotonic` [s]

    def start(self) -> None:
        """Start the thread, unless it runs."""
        if self._thread is None:
            self._queue.open()
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def stop(self, patience_s: float | None = None) -> bool:
        """Drop what waits, finish the current item and end the thread.

        Args:
            patience_s: Longest wait for the current item [s]; then the thread is left to itself, and `left_behind` in it.

        Returns:
            Whether the current item was finished.
        """
        self._queue.close("stopped", self._idle)
        if self._thread is None:
            return True
        self._thread.join(patience_s)
        finished, self._thread, self._since = not self._thread.is_alive(), None, None
        return finished

    @property
    def left_behind(self) -> bool:
        """Whether the calling thread is one that `stop` did not wait for."""
        return threading.current_thread() is not self._thread

    @property
    def busy_s(self) -> float:
        """How long the current item has been at work [s]; 0 without one."""
        since = self._since
        return 0.0 if since is None else time.monotonic() - since

    def _run(self) -> None:
        while not self.left_behind and (item := self._queue.get()) is not None:
            self._since = time.monotonic()
            try:
                self._work(item)
            except Exception as err:  # noqa: BLE001  it would end the thread
                self._on_error(err)
            if not self.left_behind:
                self._since = None
