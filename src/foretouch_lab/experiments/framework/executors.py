# SPDX-License-Identifier: Apache-2.0
"""Run cells in processes of this machine or as tasks of a Ray cluster; the rows do not depend on which.

A cell takes plain data and returns plain data; an exception becomes a failed result with its reason. Each process has
one thread, so that sums have a fixed order and cells share the cores.
"""

import json
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Self

from foretouch.errors import DatasetError, ForetouchError, described
from foretouch.processes import one_thread_each, process_pool
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, find_experiment
from foretouch_lab.ray_cluster import DIED, ray_results


@dataclass(frozen=True)
class Job:
    """Parameters that all cells of a sweep share."""

    experiment: str  # its module and name, as `find_experiment` takes them
    settings: str  # resolved settings as JSON
    data: str  # path of the data; the same on every machine that takes part
    sha256: str  # hash of the data

    @classmethod
    def make(cls, experiment: Experiment[Any, Any], settings: Mapping[str, Any], data: Path, sha256: str) -> Self:
        """Job of an experiment with resolved settings."""
        return cls(f"{experiment.module}:{experiment.name}", json.dumps(settings, sort_keys=True), str(data), sha256)


@dataclass(frozen=True)
class CellResult:
    """Result of one cell."""

    cell: Cell  # the cell
    rows: list[Row] | None  # its rows; None if it failed
    error: str = ""  # reason of the failure in one line, or ""
    seconds: float = 0.0  # processor time [s]


def run_cell(job: Job, cell: Cell) -> CellResult:
    """Run one cell; the process keeps the data for the next one."""
    start = time.process_time()
    try:
        experiment, settings, data = _loaded(job)
        start = time.process_time()  # reading the data does not count
        return CellResult(cell, experiment.run(cell, settings, data), "", time.process_time() - start)
    except ForetouchError as err:
        error = str(err)
    except Exception as err:  # noqa: BLE001 - a defect in one cell must not end the sweep; it is reported
        error = described(err)
    return CellResult(cell, None, error, time.process_time() - start)


@lru_cache(maxsize=1)
def _loaded(job: Job) -> tuple[Experiment[Any, Any], Any, Any]:
    experiment = find_experiment(job.experiment)
    settings = experiment.settings.from_mapping(json.loads(job.settings), experiment.name)
    data = experiment.load(settings, Path(job.data))
    if data.sha256 != job.sha256:
        raise DatasetError(f"{job.data}: sha256: {data.sha256} is not {job.sha256}, with which the sweep started")
    return experiment, settings, data


def on_ray(job: Job, cells: Sequence[Cell], address: str, workers: int) -> Iterator[CellResult]:
    """Run cells as Ray tasks (see `ray_results`); the data of the job must have the same path on every node."""
    for cell, result, error in ray_results(partial(run_cell, job), cells, address, workers):
        yield result or CellResult(cell, None, error)


def in_processes(job: Job, cells: Sequence[Cell], workers: int) -> Iterator[CellResult]:
    """Run cells in processes of this machine and yield each result as it arrives.

    If a process dies, the cells that were running are tried once more, each alone; one that kills its process again has
    failed.
    """
    queue = deque(cells)
    with one_thread_each():
        while queue:
            suspects = yield from _until_broken(job, queue, workers)
            for cell in suspects:
                again = yield from _until_broken(job, deque([cell]), 1)
                yield from (CellResult(failed, None, DIED) for failed in again)


def _until_broken(job: Job, queue: deque[Cell], workers: int) -> Generator[CellResult, None, list[Cell]]:
    """Run cells until the queue is empty or a process dies; returns the cells that were running then."""
    running: dict[Future[CellResult], Cell] = {}
    with process_pool(workers) as pool:
        try:
            while queue or running:
                while queue and len(running) < workers:  # so that few have to be run again
                    running[pool.submit(run_cell, job, queue[0])] = queue[0]
                    queue.popleft()
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    yield done.result()
                    del running[done]
        except BrokenProcessPool:
            return list(running.values())
    return []
