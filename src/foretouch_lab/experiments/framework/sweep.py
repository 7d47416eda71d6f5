# SPDX-License-Identifier: Apache-2.0
"""Run the cells of an experiment, store each as it finishes, and build the table of all."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from foretouch.config import Settings
from foretouch.errors import ConfigError, FileError
from foretouch_lab.experiments.framework import manifest as manifests
from foretouch_lab.experiments.framework.executors import CellResult, Job, in_processes, on_ray
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row

Progress = Callable[[CellResult, int, int], None]


@dataclass(kw_only=True)
class SweepResult:
    """Result of a sweep."""

    rows: list[Row] = field(default_factory=list)  # rows of `results.csv`
    cells: int = 0  # number of cells
    reused: int = 0  # number of cells that were finished before
    finished: int = 0  # number of cells in the table
    failures: dict[str, str] = field(default_factory=dict)  # reasons of failed cells by key
    data_sha256: str = ""  # hash of the data


def run_sweep(
    experiment: Experiment[Any, Any],
    settings: Settings,
    out: Path,
    *,
    preset: str = "",
    source: Path | None = None,
    resume: bool = False,
    only_finished: bool = False,
    workers: int = 1,
    address: str | None = None,
    progress: Progress = lambda *_: None,
    finishing: Callable[[int, int], None] = lambda *_: None,
) -> SweepResult:
    """Run the unfinished cells of an experiment and write its table.

    Args:
        experiment: The experiment.
        settings: Resolved settings.
        out: Folder of the sweep.
        preset: Name of the preset, for the manifest.
        source: Path of the data, as the experiment's `prepare` takes it.
        resume: Continue the sweep in `out`, if there is one.
        only_finished: Run no cell, and write the table of those that an interrupted sweep has finished.
        workers: Number of processes, or of cores of a local Ray node.
        address: None for processes, else the address of a Ray cluster (see `ray_results`).
        progress: Called with each result, the number of finished cells and the number of all cells.
        finishing: Called with the number of steps done and of all by `Experiment.finish`, which follows.

    Returns:
        The table and the failures. A failed cell is left out of the table and is run again by the next resume.

    Raises:
        FileError: If `out` exists and `resume` is off, or cannot be written; with `only_finished`, if it holds no sweep.
        ConfigError: If the sweep in `out` has other settings or data, or two cells have the same key.
    """
    if only_finished:
        if not (out / manifests.MANIFEST_FILE).exists():
            raise FileError(out, f"contains no {manifests.MANIFEST_FILE}: no sweep was started there")
        resume = True
    if out.exists() and not resume and (not out.is_dir() or any(out.iterdir())):
        raise FileError(out, "already exists; --resume continues a sweep")
    path = experiment.prepare(settings, source, out)
    data = experiment.load(settings, path)
    cells = _cells(experiment, settings, data)
    plain = settings.to_mapping()
    fixed = {"experiment": experiment.name, "settings": plain, "data": {"sha256": data.sha256}}
    try:
        manifest = manifests.open_folder(out, fixed, experiment.resumable_settings)
        done = manifests.read_cells(out, cells)
        result = SweepResult(cells=len(cells), reused=len(done), data_sha256=data.sha256)
        manifest["preset"] = preset
        open_cells = [cell for cell in cells if cell.key not in done]
        if only_finished:
            failed = manifest.get("cells", {}).get("failed", {})
            result.failures = {cell.key: failed[cell.key] for cell in open_cells if cell.key in failed}
            open_cells = []
        else:
            manifest["sessions"].append(manifests.environment(workers, address) | {"cells_before": len(done)})
            manifests.write_manifest(out, manifest)
        job = Job.make(experiment, plain, path.absolute(), data.sha256)
        found = in_processes(job, open_cells, workers) if address is None else on_ray(job, open_cells, address, workers)
        for number, cell_result in enumerate(found if open_cells else (), len(done) + 1):
            if cell_result.rows is None:
                result.failures[cell_result.cell.key] = cell_result.error
            else:
                manifests.write_cell(out, cell_result)
            progress(cell_result, number, len(cells))
        finished = manifests.read_cells(out, cells)  # from disk, so that an interrupted sweep gives the same table
        result.finished = len(finished)
        rows = experiment.tabulate(settings, [row for cell in cells for row in finished.get(cell.key, [])])
        rows = experiment.finish(settings, data, rows, out, finishing)
        result.rows = manifests.write_results(out, rows, experiment.results)
        manifest["cells"] = {"all": len(cells), "finished": len(finished), "failed": result.failures}
        manifests.write_manifest(out, manifest)
    except OSError as err:
        raise FileError(out, err.strerror or str(err)) from err
    return result


def _cells(experiment: Experiment[Any, Any], settings: Settings, data: Any) -> list[Cell]:
    cells = list(experiment.cells(settings, data))
    keys = [cell.key for cell in cells]
    duplicates = {key for key in keys if keys.count(key) > 1}
    if duplicates or not cells:
        raise ConfigError(f"{experiment.name}: cells: " + (f"{min(duplicates)} occurs twice" if duplicates else "none"))
    return cells
