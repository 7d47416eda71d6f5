# SPDX-License-Identifier: Apache-2.0
"""Slow work beside callbacks.

`Worker` serves topics: callbacks only store, and when the work does not keep up, the newest input comes next and older ones are
dropped, so that answers are as recent as possible. The workers of a graph share a thread (`WorkerThread`). `ThreadPool` serves
services and actions, whose callbacks await it as coroutines. A multi-threaded executor would cost three times the processor time: it
rebuilds its wait set twice a message. rclpy's `EventsExecutor` has no callback groups, and raises an error where a callback asks for
what is known of a message.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, Generic, TypeVar

from rclpy.node import Node

from foretouch.camera.bounded_queue import BoundedQueue
from foretouch.ros.messages.requests import RefusalError, status_code

_CATCH_UP_S: Final = 0.25  # 90 clouds a second take nearly all of a core: a pause of 90 ms would lose some

_T = TypeVar("_T")


class WorkerThread:
    """A thread that several workers share, and that lives as long as the process.

    What its work puts into the queue of another worker comes next, before all that waits: with the nodes of one process, a cloud
    goes through all steps before another is begun.
    """

    def __init__(self, name: str) -> None:
        self._changed = threading.Condition()
        self._calls: deque[Worker[Any]] = deque()  # one for each item that was put
        self._busy: Worker[Any] | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def call(self, worker: "Worker[Any]") -> None:
        """An item was put into the queue of a worker."""
        with self._changed:
            if threading.current_thread() is self._thread:
                self._calls.appendleft(worker)
            else:
                self._calls.append(worker)
                self._changed.notify_all()

    def finish(self, worker: "Worker[Any]") -> None:
        """Wait for the current item of a worker."""
        with self._changed:
            self._changed.wait_for(lambda: worker is not self._busy)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = None
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._calls)
                worker = self._busy = self._calls.popleft()
            worker.work_on_next()


class Worker(Generic[_T]):
    """Calls `work`, which must not raise, with each item, one after the other, in order.

    At most `depth` items wait, and only the newest where the work does not keep up. `on_drop` is called with each dropped item and the reason, `superseded` or `stopped` (see
    `BoundedQueue`). The thread may be shared with other workers; None makes one of that name.
    """

    def __init__(
        self,
        name: str,
        depth: int,
        work: Callable[[_T], None],
        on_drop: Callable[[_T, str], None],
        thread: WorkerThread | None = None,
    ) -> None:
        self._work = work
        self._queue = BoundedQueue[_T](depth, patience_s=_CATCH_UP_S, on_drop=on_drop)
        self._thread = WorkerThread(name) if thread is None else thread

    def start(self) -> None:
        """Start to work again after `stop`."""
        self._queue.reopen()

    def put(self, item: _T) -> None:
        """Queue an item; older ones are dropped where the queue is full or the work does not keep up."""
        if self._queue.put(item):
            self._thread.call(self)

    def stop(self) -> None:
        """Finish the current item and drop the rest."""
        self._queue.close("stopped")
        self._thread.finish(self)

    def work_on_next(self) -> None:
        """Work on the oldest item, if it was not dropped; called by the thread."""
        if (item := self._queue.get(0.0)) is not None:
            self._work(item)


class ThreadPool:
    """So many threads for the requests of one node, whose executor is woken when work is done.

    At most `limit` requests wait; others are refused, as `busy`.
    """

    def __init__(self, node: Node, threads: int, limit: int) -> None:
        self._node = node
        self._limit, self._waiting = limit, 0
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=node.get_name())

    async def run(self, work: Callable[[], _T]) -> _T:
        """Run work in a thread, and return or raise what it does.

        Only for callbacks in a callback group that they do not share: a group is busy while its callback waits.
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
