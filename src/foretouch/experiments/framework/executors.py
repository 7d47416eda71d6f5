# SPDX-License-Identifier: Apache-2.0
"""One cell in whatever process it runs: plain data in, plain data out, and no exception but a named failure.

Where cells run: processes of this machine, or tasks of a Ray cluster. The rows do not depend on it.

Each process has one thread, so that sums have one order and the cores are shared by cells.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import socket
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from foretouch.errors import ConfigError, DatasetError, ForetouchError, MissingDependencyError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, find_experiment

__all__ = ["LOCAL_CLUSTER", "Job", "Outcome", "in_processes", "on_ray", "run_cell"]


@dataclass(frozen=True)
class Job:
    """What all cells of a sweep share.

    Attributes:
        module: That holds the experiment.
        settings: Resolved, as JSON.
        data: Path of the data; the same on every machine that takes part.
        sha256: Of the data.
    """

    module: str
    settings: str
    data: str
    sha256: str

    @classmethod
    def make(cls, experiment: Experiment[Any, Any], settings: Mapping[str, Any], data: Path, sha256: str) -> Job:
        """From a resolved experiment."""
        return cls(experiment.module, json.dumps(settings, sort_keys=True), str(data), sha256)


@dataclass(frozen=True)
class Outcome:
    """What came of a cell.

    Attributes:
        cell: The cell.
        rows: Its rows; None if it failed.
        error: One line why it failed, or "".
        seconds: Processor time of its process.
    """

    cell: Cell
    rows: list[Row] | None
    error: str = ""
    seconds: float = 0.0


def run_cell(job: Job, cell: Cell) -> Outcome:
    """Run one cell. The data stay in the process for the next one."""
    start = time.process_time()
    try:
        experiment, settings, data = _loaded(job)
        start = time.process_time()  # reading the data is no part of the cell
        rows = experiment.run(cell, settings, data)
    except ForetouchError as err:
        return Outcome(cell, None, str(err), time.process_time() - start)
    except Exception as err:  # noqa: BLE001 - one cell's defect must not end the sweep; it is named and counted
        return Outcome(cell, None, f"{type(err).__name__}: {' '.join(str(err).split())}", time.process_time() - start)
    return Outcome(cell, rows, "", time.process_time() - start)


@lru_cache(maxsize=1)
def _loaded(job: Job) -> tuple[Experiment[Any, Any], Any, Any]:
    experiment = find_experiment(job.module)
    settings = experiment.settings.from_mapping(json.loads(job.settings), experiment.name)
    data = experiment.load(settings, Path(job.data))
    if data.sha256 != job.sha256:
        raise DatasetError(f"{job.data}: sha256: {data.sha256} is not {job.sha256}, which the sweep began with")
    return experiment, settings, data


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
