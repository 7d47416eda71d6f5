# SPDX-License-Identifier: Apache-2.0
"""One cell in whatever process it runs: plain data in, plain data out, and no exception but a named failure."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from foretouch.errors import DatasetError, ForetouchError
from foretouch.learning.experiments.experiment import Cell, Experiment, Row
from foretouch.learning.experiments.registry import find_experiment

__all__ = ["Job", "Outcome", "run_cell"]


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
