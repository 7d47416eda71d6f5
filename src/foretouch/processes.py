# SPDX-License-Identifier: Apache-2.0
"""One thread of linear algebra per process: sums keep their order, and processes leave the cores to each other."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment variables of such a process; they are read when NumPy is imported."""


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes that are started within the context have one thread; the variables are restored afterwards."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
