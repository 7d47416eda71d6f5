# SPDX-License-Identifier: Apache-2.0
"""Slow work of services and actions in threads, awaited by callbacks that are coroutines.

One executor thread can then deliver messages all the while: a single-threaded executor costs the
processor a third of what a multi-threaded one does, which builds its wait set anew twice a message.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from rclpy.node import Node

__all__ = ["Offload"]

_T = TypeVar("_T")


class Offload:
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
