# SPDX-License-Identifier: Apache-2.0
"""Runs an experiment's cells, keeps each as it finishes, and makes the table of all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from foretouch.config import Settings
from foretouch.errors import ConfigError, FileError
from foretouch.experiments.framework.executors import Job, Outcome, in_processes, on_ray
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.framework.manifest import (
    environment,
    open_folder,
    read_cells,
    write_cell,
    write_manifest,
    write_results,
)

__all__ = ["SweepResult", "run_sweep"]

Tell = Callable[[Outcome, int, int], None]


@dataclass(kw_only=True)
class SweepResult:
    """What came of a sweep.

    Attributes:
        rows: Of `results.csv`.
        cells: How many the experiment has.
        reused: How many of them were finished before.
        failures: Why cells failed, by key.
        data_sha256: Of the data.
    """

    rows: list[Row] = field(default_factory=list)
    cells: int = 0
    reused: int = 0
    failures: dict[str, str] = field(default_factory=dict)
    data_sha256: str = ""


def run_sweep(
    experiment: Experiment[Any, Any],
    settings: Settings,
    out: Path,
    *,
    preset: str = "",
    source: Path | None = None,
    resume: bool = False,
    workers: int = 1,
    address: str | None = None,
    tell: Tell | None = None,
) -> SweepResult:
    """Run what is not yet finished of an experiment, and write its table.

    Args:
        experiment: The experiment.
        settings: Resolved.
        out: Folder of the sweep.
        preset: Its name, for the manifest.
        source: Of the data, as the experiment's `prepare` takes it.
        resume: Go on in `out`, if something stands there.
        workers: Processes, or cores of a local Ray node.
        address: None for processes; else of a Ray cluster (see `executors.on_ray`).
        tell: Called with each outcome, how many cells are done, and how many there are.

    Returns:
        The table and the failures; a failed cell is left out of the table and is tried again by the next resume.

    Raises:
        FileError: If `out` exists and `resume` is off, or cannot be written.
        ConfigError: If what stands there has other settings or data, or two cells have one key.
    """
    if out.exists() and not resume and (not out.is_dir() or any(out.iterdir())):
        raise FileError(out, "exists already; --resume goes on with a sweep")
    path = experiment.prepare(settings, source, out)
    data = experiment.load(settings, path)
    cells = _cells(experiment, settings, data)
    plain = settings.to_mapping()
    fixed = {"experiment": experiment.name, "settings": plain, "data": {"sha256": data.sha256}}
    try:
        manifest = open_folder(out, fixed, resume=resume, free=experiment.free)
        done = read_cells(out, cells)
        manifest["preset"] = preset
        manifest["sessions"].append(environment(workers, address) | {"cells_before": len(done)})
        write_manifest(out, manifest)
        result = SweepResult(cells=len(cells), reused=len(done), data_sha256=data.sha256)
        job = Job.make(experiment, plain, path.absolute(), data.sha256)
        open_cells = [cell for cell in cells if cell.key not in done]
        for number, outcome in enumerate(_outcomes(job, open_cells, workers, address), len(done) + 1):
            if outcome.rows is None:
                result.failures[outcome.cell.key] = outcome.error
            else:
                write_cell(out, outcome)
            if tell is not None:
                tell(outcome, number, len(cells))
        finished = read_cells(out, cells)  # from disk, so that a sweep that was cut gives the very same table
        result.rows = experiment.tabulate(settings, [row for cell in cells for row in finished.get(cell.key, [])])
        write_results(out, result.rows)
        manifest["cells"] = {"all": len(cells), "finished": len(finished), "failed": result.failures}
        write_manifest(out, manifest)
    except OSError as err:
        raise FileError(out, err.strerror or str(err)) from err
    return result


def _cells(experiment: Experiment[Any, Any], settings: Settings, data: Any) -> list[Cell]:
    cells = list(experiment.cells(settings, data))
    keys = [cell.key for cell in cells]
    twice = {key for key in keys if keys.count(key) > 1}
    if twice or not cells:
        raise ConfigError(f"{experiment.name}: cells: " + (f"{min(twice)} is there twice" if twice else "none"))
    return cells


def _outcomes(job: Job, cells: Sequence[Cell], workers: int, address: str | None) -> Iterator[Outcome]:
    if not cells:
        return iter(())
    return in_processes(job, cells, workers) if address is None else on_ray(job, cells, address, workers)
