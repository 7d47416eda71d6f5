# SPDX-License-Identifier: Apache-2.0
"""Where cells run: processes of this machine, or tasks of a Ray cluster. The rows do not depend on it.

Each process has one thread, so that sums have one order and the cores are shared by cells.
"""

from __future__ import annotations

import multiprocessing
import os
import socket
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Final

from foretouch.errors import ConfigError, MissingDependencyError
from foretouch.learning.experiments.experiment import Cell
from foretouch.learning.experiments.work import Job, Outcome, run_cell

__all__ = ["LOCAL_CLUSTER", "in_processes", "on_ray"]

LOCAL_CLUSTER: Final = "local"
"""Address that starts a Ray node of this machine, for this sweep."""

_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_RETRIES: Final = 3
_DIED: Final = "its process died (killed, or out of memory)"


def in_processes(job: Job, cells: Sequence[Cell], workers: int) -> Iterator[Outcome]:
    """Run cells in processes of this machine, each outcome as it comes.

    A process that dies takes only its cells along: those that were running are tried once more, each alone, and the
    one that kills its process again has failed.
    """
    queue = deque(cells)
    with _environment(_ONE_THREAD):
        while queue:
            suspects = yield from _until_broken(job, queue, workers)
            for cell in suspects:
                again = yield from _until_broken(job, deque([cell]), 1)
                yield from (Outcome(guilty, None, _DIED) for guilty in again)


def on_ray(job: Job, cells: Sequence[Cell], address: str, workers: int) -> Iterator[Outcome]:
    """Run cells as Ray tasks, each outcome as it comes; a lost node costs its running tasks, which go elsewhere.

    Args:
        job: Its data must lie at the same path on every node, and foretouch be installed there.
        cells: Tasks of one core each.
        address: `auto`, `ray://host:port` or `host:port`: a cluster that runs; `local` starts a node of this machine.
        workers: Cores of that node.

    Raises:
        MissingDependencyError: If ray is not installed.
        ConfigError: If no cluster answers.
    """
    try:
        import ray
    except ImportError as err:
        raise MissingDependencyError("ray is not installed: pip install 'foretouch[sweep]'") from err
    _require_answer(address)
    try:
        if address == LOCAL_CLUSTER:
            # Named, for otherwise RAY_ADDRESS would be asked.
            ray.init(address="local", num_cpus=workers, include_dashboard=False, log_to_driver=False)
        else:
            ray.init(address=address, log_to_driver=False)
    except (ray.exceptions.RayError, ConnectionError, ImportError, ValueError, RuntimeError) as err:
        raise ConfigError(f"--address: {address}: {' '.join(str(err).split())}") from err
    try:
        task = ray.remote(num_cpus=1, max_retries=_RETRIES, runtime_env={"env_vars": _ONE_THREAD})(run_cell)
        running = {task.remote(job, cell): cell for cell in cells}
        while running:
            (done, *_), _ = ray.wait(list(running), num_returns=1)
            cell = running.pop(done)
            try:
                yield ray.get(done)
            except ray.exceptions.RayError as err:
                yield Outcome(cell, None, f"{_DIED}: {type(err).__name__}, {_RETRIES + 1} times")
    finally:
        ray.shutdown()


def _until_broken(job: Job, queue: deque[Cell], workers: int) -> Generator[Outcome, None, list[Cell]]:
    """Take cells from the queue until it is empty or a process dies; returns the cells that were running then."""
    running: dict[Future[Outcome], Cell] = {}
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            while queue or running:
                while queue and len(running) < workers:  # no more, so that few are under suspicion
                    running[pool.submit(run_cell, job, queue[0])] = queue[0]
                    queue.popleft()
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    yield done.result()
                    del running[done]
        except BrokenProcessPool:
            return list(running.values())
    return []


def _require_answer(address: str) -> None:
    """Find out at once what Ray would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return
    try:
        with socket.create_connection((host, int(port)), timeout=10.0):
            return
    except (OSError, ValueError, OverflowError) as err:
        raise ConfigError(f"--address: {address}: no cluster answers: {err}") from err


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set variables for the processes that are started within."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
