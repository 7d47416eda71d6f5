# SPDX-License-Identifier: Apache-2.0
"""Define and find experiments: settings, data, small independent cells, a table and figures of their rows.

An experiment is a module or package that holds an `EXPERIMENT`, or `EXPERIMENTS` where several share their code. To add
one, add a module beside this folder; a module elsewhere is found by its dotted name, such as `my_lab.stiffness`.

A cell is plain data and runs in any process or on any machine. Its rows follow from settings, data and cell alone.
"""

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from foretouch.config import Settings
from foretouch.errors import ConfigError, none_of
from foretouch_lab.learning.data import load_dataset

_PACKAGE: Final = "foretouch_lab.experiments"

Row = dict[str, Any]  # plain JSON data by column


@dataclass(frozen=True)
class Cell:
    """One task of a sweep."""

    key: str  # unique in the sweep and stable; letters, digits, `_`, `-`, `.` and `+`: the name of its file
    values: Mapping[str, Any]  # plain JSON parameters of the task; they are repeated in each of its rows


@dataclass(frozen=True)
class Table:
    """A table for the terminal and `summary.md`, with notes below it."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()


def require_data(_settings: Any, source: Path | None, _out: Path) -> Path:
    """Return the given data, or raise a `ConfigError` if no data are given: the default `prepare`."""
    if source is None:
        raise ConfigError("experiment: no data; give --data PATH or set FORETOUCH_DATA")
    return source


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Declaration of one experiment; its functions take its settings, and its data as `load` returns them.

    Attributes:
        name: Name on the command line and in the manifest.
        question: What the experiment answers, in one sentence.
        module: Module from which other processes import the experiment: `__name__`.
        settings: Class of its settings.
        presets: By name, the settings that differ from the defaults; `full` is what is reported.
        load: (settings, path of the data) to the data, whose `sha256` is the hash of their content; called once in each
            process. By default `load_dataset`.
        cells: All tasks, in a fixed order.
        run: Rows of one cell. Pure: no file, no clock, no global randomness.
        tabulate: Rows of the finished cells, each with its cell's values and in order of the cells, to `results.csv`.
        summarise: Rows of `results.csv` to the tables on the terminal.
        figure: (rows of `results.csv`, folder) to the figures that it wrote; matplotlib is only imported when it is
            called.
        prepare: (settings, --data or None, folder of the sweep) to the path of the data, which it may generate.
        resumable_settings: Settings that only select cells or change how rows are summarised. They may change when a
            sweep is resumed: finished cells are kept, such as hours of one predictor when another one is added.
        data_folder: Folder below FORETOUCH_DATA that is used without --data; None if there is no default.
        goes_without: Whether it can do without this folder.
        results: Name of the table's file.
    """

    name: str
    question: str
    module: str
    settings: type[Settings]
    presets: Mapping[str, Mapping[str, Any]]
    cells: Callable[[Any, Any], Sequence[Cell]]
    run: Callable[[Cell, Any, Any], list[Row]]
    tabulate: Callable[[Any, Sequence[Row]], list[Row]]
    summarise: Callable[[Sequence[Row]], Sequence[Table]]
    figure: Callable[[Sequence[Row], Path], list[Path]] | None = None
    prepare: Callable[[Any, Path | None, Path], Path] = require_data
    load: Callable[[Any, Path], Any] = lambda _settings, path: load_dataset(path)
    resumable_settings: Sequence[str] = ()
    data_folder: str | None = None
    goes_without: bool = False
    results: str = "results.csv"

    @property
    def command(self) -> str:
        """Words that run it."""
        return f"foretouch experiment {self.name}"

    def resolve(self, preset: str, overrides: Mapping[str, Any]) -> Any:
        """Return the settings of a preset with overrides; a `ConfigError` if one is unknown or out of its bounds."""
        if preset not in self.presets:
            raise ConfigError(f"{self.name}: preset: {none_of(preset, self.presets)}")
        base = self.settings.from_mapping(self.presets[preset], f"{self.name}: {preset}")
        return base.updated(overrides, self.name)

    def finish(
        self, _settings: Any, _data: Any, rows: list[Row], _out: Path, _progress: Callable[[int, int], None], /
    ) -> list[Row]:
        """Complete the rows of `tabulate` in this process, once all cells have run: here, with nothing.

        `_out` is the folder of the sweep; `_progress` is called with the number of steps done and of all.
        """
        return rows

    def facts(self, _rows: Sequence[Row], /) -> dict[str, Any]:
        """Return further entries of the command's result in JSON."""
        return {}

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """Return tables of `results.csv` for the terminal and `summary.md`; none without rows."""
        return list(self.summarise(rows)) if rows else []

    def draw(self, rows: Sequence[Row], folder: Path) -> list[Path]:
        """Draw the figures of `results.csv` into a folder; none without rows or without a `figure`."""
        return self.figure(rows, folder) if self.figure is not None and rows else []


def list_experiments() -> list[Experiment]:
    """Return the experiments of this package, by name."""
    return sorted(
        [experiment for module in _modules() for experiment in _held_by(module)], key=lambda experiment: experiment.name
    )


def find_experiment(name: str) -> Experiment:
    """Find an experiment by name, or by the dotted name of a user's module that holds it.

    A module that holds several is followed by a colon and the name: `my_lab.stiffness:rubber`.

    Raises:
        ConfigError: If there is none.
    """
    module, _, own = name.partition(":")
    if "." not in module:
        places = sorted(_modules(), key=lambda place: not place.endswith(f".{name}"))  # imports as few as it can
        if known := next(
            (candidate for place in places for candidate in _held_by(place) if candidate.name == name), None
        ):
            return known
        raise ConfigError(f"experiment: {none_of(name, [experiment.name for experiment in list_experiments()])}")
    cure = "give a name of `foretouch experiment list`, or of a module of yours, such as my_lab.stiffness"
    if not all(part.isidentifier() for part in module.split(".")):
        raise ConfigError(f"experiment: {name}: is no name of a module: {cure}")
    try:
        experiments = _held_by(module)
    except ModuleNotFoundError as err:
        raise ConfigError(f"experiment: {name}: {err}: {cure}") from err
    if not experiments:
        raise ConfigError(f"experiment: {name}: contains no EXPERIMENT")
    chosen = [candidate for candidate in experiments if own in ("", candidate.name)]
    if len(chosen) != 1:
        raise ConfigError(
            f"experiment: {name!r} is not one of {', '.join(f'{module}:{candidate.name}' for candidate in experiments)}"
        )
    return chosen[0]


def _modules() -> list[str]:
    """Return modules and folders of the package."""
    return [f"{_PACKAGE}.{module.name}" for module in pkgutil.iter_modules(importlib.import_module(_PACKAGE).__path__)]


def _held_by(module: str) -> list[Experiment]:
    """Return experiments of a module; none if it is not an experiment."""
    held = importlib.import_module(module)
    listed = getattr(held, "EXPERIMENTS", [getattr(held, "EXPERIMENT", None)])
    return [experiment for experiment in listed if isinstance(experiment, Experiment)]
