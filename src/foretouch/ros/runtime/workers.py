# SPDX-License-Identifier: Apache-2.0
"""Slow work beside callbacks.

`Worker` serves topics: callbacks only store, and the newest input comes next. `ThreadPool` serves services and actions, whose
callbacks await it as coroutines. So a `SingleThreadedExecutor` of rclpy serves a whole graph.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Generic, TypeVar

from rclpy.node import Node

from foretouch.ros.messages.requests import RefusalError, status_code

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


class ThreadPool:
    """Threads for the requests of a node, whose executor is woken when work is done.

    Args:
        node: The node.
        threads: Number of threads.
        limit: Number of requests that may wait or be worked on; others are refused as `busy`.
    """

    def __init__(self, node: Node, threads: int, limit: int) -> None:
        self._node = node
        self._limit, self._waiting = limit, 0
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=node.get_name())

    async def run(self, work: Callable[[], _T]) -> _T:
        """Run work in a thread, and return or raise what it does.

        Only for callbacks in a reentrant callback group: another group is busy while its callback waits.
        """
        if self._waiting >= self._limit:
            raise RefusalError(status_code("busy"), f"busy: {self._limit} requests wait already: ask again later")
        self._waiting += 1
        try:
            future = self._pool.submit(work)
            future.add_done_callback(self._wake)
            while not future.done():  # noqa: ASYNC110  the executor goes on below when it is woken
                await asyncio.sleep(0)
            return future.result()
        finally:
            self._waiting -= 1

    def close(self) -> None:
        """Wait for running work and cancel the rest."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _wake(self, _: Future[Any]) -> None:
        if self._node.executor is not None:
            self._node.executor.wake()
