# SPDX-License-Identifier: Apache-2.0
"""Slow work beside callbacks.

`Worker` serves topics: callbacks only store, and when the work does not keep up, the newest input comes next and older ones are
dropped, so that answers are as recent as possible. The workers of a graph share two threads (`WorkerThreads`). `ThreadPool` serves
services and actions, whose callbacks await it as coroutines. A multi-threaded executor would cost three times the processor time: it
rebuilds its wait set twice a message. rclpy's `EventsExecutor` has no callback groups, and raises an error where a callback asks for
what is known of a message.
"""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, Generic, TypeVar

from rclpy.node import Node

from foretouch.camera.bounded_queue import BoundedQueue
from foretouch.ros.messages.requests import RefusalError, status_code

PATIENCE_S: Final = 10.0
"""How long a request waits for a thread until it is refused [s]."""

_CATCH_UP_S: Final = 0.25  # 90 clouds a second take nearly all of a core: a pause of 90 ms would lose some
_THREADS: Final = 2  # for as many clouds: a third would wait for the interpreter's lock, and make all answers older

_T = TypeVar("_T")


class WorkerThreads:
    """Two threads that several workers share; they end when the last worker is stopped.

    Each worker works on one item at a time, in order. What its work puts into the queue of another worker comes next, before all
    that waits: with the nodes of one process, a cloud goes through all steps in one thread. While that thread plans the grasps of a
    cloud, the other one segments the next: much of both is C code, which runs without the interpreter's lock.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        lock = threading.Lock()
        self._called, self._done = threading.Condition(lock), threading.Condition(lock)  # threads wait, `stop` waits
        self._started: set[Worker[Any]] = set()
        self._calls: deque[Worker[Any]] = deque()  # one for each item that was put
        self._next: deque[Worker[Any]] = deque()  # the same, by work itself: the latest first
        self._busy: set[Worker[Any]] = set()
        self._threads: list[threading.Thread] = []

    def start(self, worker: "Worker[Any]") -> None:
        """Serve a worker."""
        with self._called:
            self._started.add(worker)
            while len(self._threads) < _THREADS:
                self._threads.append(threading.Thread(target=self._run, name=self._name, daemon=True))
                self._threads[-1].start()

    def call(self, worker: "Worker[Any]") -> None:
        """An item was put into the queue of a worker."""
        with self._called:
            if threading.current_thread() in self._threads:
                self._next.appendleft(worker)  # for this thread, once its current work is done
            else:
                self._calls.append(worker)
                self._called.notify()

    def stop(self, worker: "Worker[Any]") -> None:
        """Wait for the current item of a worker and serve it no more."""
        with self._done:
            self._started.discard(worker)
            self._done.wait_for(lambda: worker not in self._busy)
            ended: list[threading.Thread] = []
            if not self._started:
                ended, self._threads = self._threads, ended
                self._called.notify_all()
        for thread in ended:
            thread.join()

    def _run(self) -> None:
        while (worker := self._begin()) is not None:
            worker.work_on_next()
            with self._done:
                self._busy.discard(worker)
                self._done.notify_all()

    def _begin(self) -> "Worker[Any] | None":
        """Wait for work; None where this thread is to end."""
        own = threading.current_thread()
        with self._called:
            while own in self._threads:
                if (worker := self._ready()) is not None:
                    (self._next or self._calls).remove(worker)
                    self._busy.add(worker)
                    if self._ready() is not None:
                        self._called.notify()
                    return worker
                self._called.wait()
        return None

    def _ready(self) -> "Worker[Any] | None":
        """What can be worked on: no new item is begun while another waits for its next step."""
        return next((one for one in self._next or self._calls if one not in self._busy), None)


class Worker(Generic[_T]):
    """Calls `work`, which must not raise, with each item, one after the other, in order.

    At most `depth` items wait, and only the newest where the work does not keep up. `on_drop` is called with each dropped item and the reason, `superseded` or `stopped` (see
    `BoundedQueue`). The threads may be shared with other workers; None makes some of that name.
    """

    def __init__(
        self,
        name: str,
        depth: int,
        work: Callable[[_T], None],
        on_drop: Callable[[_T, str], None],
        threads: WorkerThreads | None = None,
    ) -> None:
        self._work = work
        self._queue = BoundedQueue[_T](depth, patience_s=_CATCH_UP_S, on_drop=on_drop)
        self._threads = WorkerThreads(name) if threads is None else threads

    def start(self) -> None:
        """Start to work, unless it has started."""
        self._queue.reopen()
        self._threads.start(self)

    def put(self, item: _T) -> None:
        """Queue an item; older ones are dropped where the queue is full or the work does not keep up."""
        if self._queue.put(item):
            self._threads.call(self)

    def stop(self) -> None:
        """Finish the current item and drop the rest."""
        self._queue.close("stopped")
        self._threads.stop(self)

    def work_on_next(self) -> None:
        """Work on the oldest item, if it was not dropped; called by one of the threads."""
        if (item := self._queue.get(0.0)) is not None:
            self._work(item)


class ThreadPool:
    """So many threads for the requests of one node, whose executor is woken when work is done.

    At most `limit` requests wait, for `PATIENCE_S` each; others are refused, as `busy`.
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
            future = self._pool.submit(_in_time, work, time.monotonic() + PATIENCE_S)
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


def _in_time(work: Callable[[], _T], end_s: float) -> _T:
    """Do work that has waited until a time at most [s], or refuse it."""
    if time.monotonic() > end_s:
        raise RefusalError(
            status_code("busy"), f"busy: waited for {PATIENCE_S:g} s behind other requests: ask again later"
        )
    return work()
