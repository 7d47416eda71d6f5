# SPDX-License-Identifier: Apache-2.0
"""Threads for slow work, so that one executor thread can deliver messages all the time.

`Worker` serves topics: callbacks only store, and when the work does not keep up, the oldest input is dropped, so
that answers are as recent as possible. `ThreadPool` serves services and actions, whose callbacks await it as
coroutines. A multi-threaded executor would cost three times the processor time: it rebuilds its wait set twice a
message.
"""

import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from rclpy.node import Node

from foretouch.bounded_queue import BoundedQueue

_T = TypeVar("_T")


class Worker(Generic[_T]):
    """Calls `work` with each item, in order, in one thread.

    Args:
        name: Of the thread.
        depth: Items that may wait.
        work: Called with each item; must not raise.
        on_drop: Called with each dropped item and the reason, `superseded` or `stopped` (see `BoundedQueue`).
    """

    def __init__(self, name: str, depth: int, work: Callable[[_T], None], on_drop: Callable[[_T, str], None]) -> None:
        self._name = name
        self._work = work
        self._queue = BoundedQueue[_T](depth, on_drop=on_drop)
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread, unless it is running."""
        if self._thread is None:
            self._queue.reopen()
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def put(self, item: _T) -> None:
        """Queue an item; the oldest is dropped where the queue is full."""
        self._queue.put(item)

    def stop(self) -> None:
        """Finish the current item, drop the rest and end the thread."""
        self._queue.close("stopped")
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            self._work(item)


class ThreadPool:
    """A pool of threads for one node.

    Args:
        node: Its executor is woken when work is done.
        threads: Number of requests that are worked on at a time.
    """

    def __init__(self, node: Node, threads: int) -> None:
        self._node = node
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=node.get_name())

    async def run(self, work: Callable[[], _T]) -> _T:
        """Run work in a thread, and return or raise what it does.

        Only for callbacks in a callback group that they do not share: a group is busy while its callback waits.
        """
        future = self._pool.submit(work)
        future.add_done_callback(self._wake)
        while not future.done():
            await _Pause()
        return future.result()

    def close(self) -> None:
        """Wait for running work and cancel the rest."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _wake(self, _: Future[_T]) -> None:
        executor = self._node.executor
        if executor is not None:
            executor.wake()


class _Pause:
    """Returns control to the executor, which continues here when it is woken."""

    def __await__(self) -> Generator[None, None, None]:
        yield
