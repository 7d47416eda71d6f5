# SPDX-License-Identifier: Apache-2.0
"""Run the cells of an experiment, in processes or as tasks of a Ray cluster, store each as it finishes, and build the table.

A cell takes plain data and returns plain data, so the rows do not depend on where it runs; an exception becomes a failed
cell with its reason. Each process has one thread, so that sums have a fixed order and cells share the cores.
"""

import json
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from foretouch.base.files import system_errors
from foretouch.base.processes import process_pool
from foretouch.config import Settings
from foretouch.errors import ConfigError, DatasetError, FileError
from foretouch_lab.experiments.framework import manifest as manifests
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, find_experiment
from foretouch_lab.ray_cluster import DIED, outcome, ray_results

Outcome = tuple[Cell, Any, str]
"""A cell, its rows with the processor time that they took [s], and the reason of a failure: then there are no rows."""


class Sweep:
    """One run of an experiment: its data, its cells and its folder. Call `run`, then `finish`.

    Args:
        experiment: The experiment.
        settings: Resolved settings.
        out: Folder of the sweep.
        preset: Name of the preset, for the manifest.
        source: Path of the data, as the experiment's `prepare` takes it.
        resume: Continue the sweep in `out`, if there is one.

    Attributes:
        cells: All cells in order.
        reused: Number of cells that were finished before.
        finished: Number of cells in the table.
        failures: Reasons of failed cells by key. They are left out of the table, and run again by the next resume.
        rows: Rows of the table.
        data_sha256: Hash of the data.

    Raises:
        FileError: If `out` exists and `resume` is off, or cannot be written.
        ConfigError: If the sweep in `out` has other settings or data, or two cells have the same key.
    """

    def __init__(
        self,
        experiment: Experiment,
        settings: Settings,
        out: Path,
        *,
        preset: str = "",
        source: Path | None = None,
        resume: bool = False,
    ) -> None:
        if out.exists() and not resume and (not out.is_dir() or any(out.iterdir())):
            raise FileError(out, "already exists; --resume continues a sweep")
        self._experiment = experiment
        self._settings = settings
        self._out = out
        self._path = experiment.prepare(settings, source, out)
        self._data = experiment.load(settings, self._path)
        self.data_sha256: str = self._data.sha256
        self.cells = _cells(experiment, settings, self._data)
        self.failures: dict[str, str] = {}
        self.rows: list[Row] = []
        self.finished = 0
        plain = settings.to_mapping()
        fixed = {"experiment": experiment.name, "settings": plain, "data": {"sha256": self.data_sha256}}
        with system_errors(out):
            self._manifest = manifests.open_folder(out, fixed, experiment.resumable_settings)
            done = manifests.read_cells(out, self.cells)
        self._manifest["preset"] = preset
        self._left = [cell for cell in self.cells if cell.key not in done]
        self.reused = len(done)

    def run(
        self,
        workers: int = 1,
        address: str | None = None,
        progress: Callable[[str, float, str, int, int], None] = lambda *_: None,
    ) -> None:
        """Run the cells that are not finished, and store each as it finishes.

        Args:
            workers: Number of processes, or of cores of a local Ray node.
            address: None for processes, else the address of a Ray cluster (see `ray_results`).
            progress: Called with the key of each cell, its processor time [s], the reason of its failure or "", and the
                numbers of finished and of all cells.

        Raises:
            FileError: If the folder cannot be written.
        """
        experiment, out = self._experiment, self._out
        text = json.dumps(self._settings.to_mapping(), sort_keys=True)
        name = f"{experiment.module}:{experiment.name}"
        task = partial(run_cell, name, text, str(self._path.absolute()), self.data_sha256)
        with system_errors(out):
            session = manifests.environment(workers, address) | {"cells_before": self.reused}
            self._manifest["sessions"].append(session)
            manifests.write_manifest(out, self._manifest)
            if not self._left:
                return
            results = (
                in_processes(task, self._left, workers)
                if address is None
                else ray_results(task, self._left, address, workers)
            )
            for number, (cell, rows, error) in enumerate(results, self.reused + 1):
                seconds = 0.0
                if rows is None:
                    self.failures[cell.key] = error
                else:
                    manifests.write_cell(out, cell, *rows)
                    seconds = rows[1]
                progress(cell.key, seconds, error, number, len(self.cells))

    def finish(self, progress: Callable[[int, int], None] = lambda *_: None) -> None:
        """Write the table of the finished cells.

        Args:
            progress: Called with the number of steps done and of all by `Experiment.finish`.

        Raises:
            FileError: If the folder cannot be written.
        """
        experiment, out = self._experiment, self._out
        with system_errors(out):
            done = manifests.read_cells(out, self.cells)  # from disk, so that an interrupted sweep gives the same table
            self.finished = len(done)
            rows = experiment.tabulate(self._settings, [row for cell in self.cells for row in done.get(cell.key, [])])
            rows = experiment.finish(self._settings, self._data, rows, out, progress)
            self.rows = manifests.write_results(out, rows, experiment.results)
            self._manifest["cells"] = {"all": len(self.cells), "finished": self.finished, "failed": self.failures}
            manifests.write_manifest(out, self._manifest)

    def origin(self, data: Path | None = None) -> list[str]:
        """Return lines of `summary.md` on how the results were made, from data that the command names or from the usual ones."""
        return manifests.origin_of(self._manifest, self._experiment, data)


def _cells(experiment: Experiment, settings: Settings, data: Any) -> list[Cell]:
    cells = list(experiment.cells(settings, data))
    keys = [cell.key for cell in cells]
    duplicates = {key for key in keys if keys.count(key) > 1}
    if duplicates or not cells:
        raise ConfigError(f"{experiment.name}: cells: " + (f"{min(duplicates)} occurs twice" if duplicates else "none"))
    return cells


def run_cell(experiment: str, settings: str, data: str, sha256: str, cell: Cell) -> tuple[list[Row], float]:
    """Return rows of one cell, and their processor time without the time of reading the data, which the process keeps [s].

    Args:
        experiment: Its module and name, as `find_experiment` takes them.
        settings: Resolved settings as JSON.
        data: Path of the data; the same on every machine that takes part.
        sha256: Hash of the data.
        cell: The cell.
    """
    loaded, resolved, content = _loaded(experiment, settings, data, sha256)
    start = time.process_time()
    return loaded.run(cell, resolved, content), time.process_time() - start


@lru_cache(maxsize=1)
def _loaded(name: str, text: str, path: str, sha256: str) -> tuple[Experiment, Any, Any]:
    experiment = find_experiment(name)
    settings = experiment.settings.from_mapping(json.loads(text), experiment.name)
    data = experiment.load(settings, Path(path))
    if data.sha256 != sha256:
        raise DatasetError(f"{path}: sha256: {data.sha256} is not {sha256}, with which the sweep started")
    return experiment, settings, data


def in_processes(run: Callable[[Cell], Any], cells: Sequence[Cell], workers: int) -> Iterator[Outcome]:
    """Run cells in processes of this machine and yield each outcome as it arrives, as `ray_results` does.

    If a process dies, the cells that were running are tried once more, each alone; one that kills its process again has
    failed.
    """
    queue = deque(cells)
    while queue:
        suspects = yield from _until_broken(run, queue, workers)
        for cell in suspects:
            again = yield from _until_broken(run, deque([cell]), 1)
            yield from ((failed, None, DIED) for failed in again)


def _until_broken(run: Callable[[Cell], Any], queue: deque[Cell], workers: int) -> Generator[Outcome, None, list[Cell]]:
    """Run cells until the queue is empty or a process dies; returns the cells that were running then."""
    running: dict[Future[tuple[Any, str]], Cell] = {}
    with process_pool(workers) as pool:
        try:
            while queue or running:
                while queue and len(running) < workers:  # so that few have to be run again
                    running[pool.submit(outcome, run, queue[0])] = queue[0]
                    queue.popleft()
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running[done], *done.result()
                    del running[done]
        except BrokenProcessPool:
            return list(running.values())
    return []
