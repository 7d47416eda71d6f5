# SPDX-License-Identifier: Apache-2.0
"""Worker processes: one thread of linear algebra each, and no part in the signals of the terminal.

With one thread, sums keep their order, and processes leave the cores to each other.
"""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, Final

from foretouch.base.interrupts import uninterrupted

ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment variables of such a process; they are read when NumPy is imported."""


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Start processes of one thread each that do not see Ctrl-C, which the terminal sends to them too, and that end with the context.

    The environment variables are restored afterwards.
    """
    children, variables = set(active_children()), {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    pool = _Pool(workers, get_context("spawn"))
    try:
        yield pool
    except BaseException:
        pool._end(set(active_children()) - children)  # noqa: SLF001  of this module
        raise
    finally:
        pool.shutdown()
        for name in variables:
            os.environ.pop(name, None)
        os.environ.update({name: value for name, value in variables.items() if value is not None})


class _Pool(ProcessPoolExecutor):
    def _end(self, children: Iterable[BaseProcess]) -> None:
        """End now, with the processes."""
        results: Any = self._result_queue
        self.shutdown(wait=False, cancel_futures=True)
        for child in children:
            child.terminate()
        results._writer.close()  # noqa: SLF001  or it waits for the rest of a result that a process was sending

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Start processes with SIGINT blocked from their first moment."""
        with uninterrupted():  # or a process would miss what it is to do
            resource_tracker.ensure_running()  # it would unblock the signal
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                return super().submit(fn, *args, **kwargs)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
