# SPDX-License-Identifier: Apache-2.0
"""What an experiment is: settings, data, small independent cells, and the table made of their rows.

An experiment is a module that holds an `EXPERIMENT`. A cell is plain data and runs anywhere: in a process of this
machine or on another one; its rows follow from settings, data and cell alone, so that they are the same wherever it runs.

The experiments by name.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, Protocol, TypeVar

from foretouch.config import Settings
from foretouch.errors import ConfigError

__all__ = ["EXPERIMENTS", "Cell", "Experiment", "HashedData", "Row", "Table", "find_experiment", "require_data"]


Row = dict[str, Any]
"""Plain JSON data by column."""


class HashedData(Protocol):
    """What cells are run on."""

    @property
    def sha256(self) -> str:
        """Of the content; a cell refuses data of another hash than the sweep's."""
        ...


@dataclass(frozen=True)
class Cell:
    """One task of a sweep.

    Attributes:
        key: Unique in the sweep and stable; letters, digits, `_`, `-`, `.` and `+`: the name of its file.
        values: Plain JSON data: what is to be done. Stands in each of its rows.
    """

    key: str
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Table:
    """What a person sees at the end: texts, and notes below."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()


S = TypeVar("S", bound=Settings)
D = TypeVar("D", bound=HashedData)


def require_data(settings: Settings, source: Path | None, out: Path) -> Path:
    """The usual `prepare`: the data must be given.

    Raises:
        ConfigError: If they are not.
    """
    del settings, out
    if source is None:
        raise ConfigError("experiment: no data; give --data PATH or set FORETOUCH_DATA")
    return source


@dataclass(frozen=True, kw_only=True)
class Experiment(Generic[S, D]):
    """How one experiment is set up, run and told.

    Attributes:
        name: As in the command.
        question: That it answers, in one sentence.
        module: Where its `EXPERIMENT` is found by other processes: `__name__`.
        settings: Class of its settings.
        presets: By name, what differs from the defaults; `full` is what is reported.
        load: (settings, path of the data) to the data; called once in each process.
        cells: All tasks, in an order that does not change.
        run: The rows of one cell. Pure: no file, no clock, no global randomness.
        tabulate: All rows of the finished cells, each with its cell's values, in order of the cells, to `results.csv`.
        summarise: The rows of `results.csv` to the tables on the terminal.
        prepare: (settings, --data or None, folder of the sweep) to the path of the data; makes them where they are made.
        free: Settings that only choose cells, or how their rows are told. They may change when a sweep goes on: what is
            finished stays, such as hours of one predictor when another one is added.
        data_folder: Below FORETOUCH_DATA, used where --data is not given; None where that is of no use.
    """

    name: str
    question: str
    module: str
    settings: type[S]
    presets: Mapping[str, Mapping[str, Any]]
    load: Callable[[S, Path], D]
    cells: Callable[[S, D], Sequence[Cell]]
    run: Callable[[Cell, S, D], list[Row]]
    tabulate: Callable[[S, Sequence[Row]], list[Row]]
    summarise: Callable[[Sequence[Row]], Sequence[Table]]
    prepare: Callable[[S, Path | None, Path], Path] = field(default=require_data)
    free: Sequence[str] = ()
    data_folder: str | None = None

    def resolve(self, preset: str, overrides: Mapping[str, Any]) -> S:
        """Settings of a preset, with what differs from it.

        Raises:
            ConfigError: If there is no such preset, or a setting is unknown or out of its bounds.
        """
        if preset not in self.presets:
            raise ConfigError(f"{self.name}: preset: {preset!r} is none of {', '.join(self.presets)}")
        base = self.settings.from_mapping(self.presets[preset], f"{self.name}: {preset}")
        return base.updated(overrides, self.name)


EXPERIMENTS: Final = {
    name: f"foretouch.experiments.{name}.experiment"
    for name in (
        "cross_validation",
        "time_blocked",
        "cross_type",
        "unseen_object",
        "noise_ceiling",
        "lookalikes",
        "sim_to_real",
        "coverage",
        "ablation",
        "learning_curve",
        "label_ratio",
        "label_ratio_tuning",
    )
}


def find_experiment(name: str) -> Experiment[Any, Any]:
    """An experiment by name, or by the module of one's own that holds an `EXPERIMENT`, such as `my_lab.stiffness`.

    Raises:
        ConfigError: If there is none.
    """
    if name not in EXPERIMENTS and "." not in name:
        raise ConfigError(f"experiment: {name!r} is none of {', '.join(EXPERIMENTS)}")
    module = EXPERIMENTS.get(name, name)
    try:
        found = getattr(importlib.import_module(module), "EXPERIMENT", None)
    except ModuleNotFoundError as err:
        raise ConfigError(f"experiment: {name}: {err}") from err
    if not isinstance(found, Experiment):
        raise ConfigError(f"experiment: {name}: holds no EXPERIMENT")
    return found
