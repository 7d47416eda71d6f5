# SPDX-License-Identifier: Apache-2.0
"""One thread that does a node's slow work, and the bounded queue before it.

Callbacks of the executor only store; when the work does not keep up, the oldest input is given up, so
that what is answered is as fresh as possible.

Slow work of services and actions in threads, awaited by callbacks that are coroutines.

One executor thread can then deliver messages all the while: a single-threaded executor costs the
processor a third of what a multi-threaded one does, which builds its wait set anew twice a message.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from rclpy.node import Node

__all__ = ["ThreadPool", "Worker"]


_T = TypeVar("_T")


class Worker(Generic[_T]):
    """Runs `work` on each item, in order, in a thread of its own.

    Args:
        name: Of the thread.
        depth: Items that may wait.
        work: Called with each item; must not raise.
        on_drop: Called with an item and the reason it was given up: `superseded` by newer ones, or
            `stopped` before its turn.
    """

    def __init__(self, name: str, depth: int, work: Callable[[_T], None], on_drop: Callable[[_T, str], None]) -> None:
        self._name = name
        self._depth = depth
        self._work = work
        self._on_drop = on_drop
        self._items: deque[_T] = deque()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._stopping = False

    def start(self) -> None:
        """Begin to work; does nothing where it runs already."""
        if self._thread is None:
            self._stopping = False
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def put(self, item: _T) -> None:
        """Queue an item, giving up the oldest where the queue is full."""
        with self._changed:
            pushed_out = self._items.popleft() if len(self._items) >= self._depth else None
            self._items.append(item)
            self._changed.notify()
        if pushed_out is not None:
            self._on_drop(pushed_out, "superseded")

    def stop(self) -> None:
        """Finish the item at hand, give up the rest and end the thread."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        while self._items:
            self._on_drop(self._items.popleft(), "stopped")

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items or self._stopping)
                if self._stopping:
                    return
                item = self._items.popleft()
            self._work(item)


class ThreadPool:
    """A pool of threads for one node.

    Args:
        node: Its executor is woken when work is done.
        threads: Requests worked on at a time.
    """

    def __init__(self, node: Node, threads: int) -> None:
        self._node = node
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=node.get_name())

    async def run(self, work: Callable[[], _T]) -> _T:
        """Do work in a thread and give what it gives, or raises.

        Only for callbacks in a callback group of their own: a group is busy while its callback waits.
        """
        future = self._pool.submit(work)
        future.add_done_callback(self._wake)
        while not future.done():
            await _Pause()
        return future.result()

    def close(self) -> None:
        """Wait for the work at hand; what has not begun is cancelled."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _wake(self, _: Future[_T]) -> None:
        executor = self._node.executor
        if executor is not None:
            executor.wake()


class _Pause:
    """Hands control back to the executor, which comes again when it is woken."""

    def __await__(self) -> Generator[None, None, None]:
        yield
