# SPDX-License-Identifier: Apache-2.0
"""Time the steps of the pipeline."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def timed(times_ms: dict[str, float], name: str) -> Iterator[None]:
    """Add the wall time of the block under a name, also when it fails [ms]."""
    start = time.perf_counter()
    try:
        yield
    finally:
        times_ms[name] = times_ms.get(name, 0.0) + (time.perf_counter() - start) * 1e3
