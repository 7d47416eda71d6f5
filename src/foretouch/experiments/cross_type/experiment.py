# SPDX-License-Identifier: Apache-2.0
"""P1's tables: five folds within cylinders and within boxes, and training on one type to test on the other.

P1 recorded a crisps can and a coffee can, a snacks box and a sugar box. The sugar box is not in the public data:
`p1_boxes` is left with one object and is no table; `boxes` are all that are there. P1 does not tell in
which direction it crossed the types, so its figure stands beside both directions together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.framework.tables import skill_tables
from foretouch.experiments.shared.folds import FoldRunner, Part
from foretouch.experiments.shared.real_grasps import (
    EVERYTHING,
    FREE,
    PRESETS,
    RealGraspSettings,
    labelled,
    load,
    score_table,
)
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.folds import Fold, Indices, random_folds
from foretouch.learning.evaluation.comparison import MEAN
from foretouch.tactile.modalities import MODALITIES
from foretouch.types import GraspSample

__all__ = ["EXPERIMENT", "PUBLISHED", "CrossTypeSettings"]

ACROSS: Final = "across types"
PUBLISHED: Final[dict[str, dict[str, tuple[float, float | None]]]] = {
    "within p1_cylinders": {
        "PDC_TH": (208.0, 0.067),
        "PDC_MF": (153.0, 0.076),
        "E_TH": (216.0, 0.061),
        "E_MF": (231.0, 0.060),
    },
    "within boxes": {
        "PDC_TH": (278.0, 0.089),
        "PDC_MF": (164.0, 0.081),
        "E_TH": (232.0, 0.066),
        "E_MF": (212.0, 0.055),
    },
    ACROSS: {"PDC_TH": (236.0, None), "PDC_MF": (165.0, None), "E_TH": (317.0, None), "E_MF": (310.0, None)},
}
"""P1, sections III and IV: RMSE in counts and over its divisors, beside the table that comes closest."""

_P1: Final = "P1 (published)"
_FOLDS: Final = 5


@dataclass(frozen=True, kw_only=True)
class ObjectTypes(Settings):
    """Which object is of which type; the names are those of the collection."""

    cylinders: tuple[str, ...] = setting(("campbells", "coffee", "pringles"), "Cans")
    boxes: tuple[str, ...] = setting(("cheezit", "spam", "wood"), "Boxes and blocks")
    p1_cylinders: tuple[str, ...] = setting(("coffee", "pringles"), "Those that P1 was trained on")

    def __post_init__(self) -> None:
        super().__post_init__()
        both = sorted(set(self.cylinders) & set(self.boxes))
        if both:
            raise ConfigError(f"ObjectTypes.boxes: {both[0]!r} is a cylinder as well")


@dataclass(frozen=True, kw_only=True)
class CrossTypeSettings(RealGraspSettings):
    """Of `cross_type`."""

    types: ObjectTypes = ObjectTypes()


def _parts(settings: CrossTypeSettings, samples: Sequence[GraspSample], seed: int) -> list[Part]:
    types = {name: _places(samples, names) for name, names in settings.types.to_mapping().items()}
    for name in ("cylinders", "boxes"):
        if not len(types[name]):
            raise DatasetError(f"cross_type: none of the objects is among types.{name}")
    parts = []
    for name, places in types.items():
        if len(places) < _FOLDS:
            continue
        folds = random_folds(len(places), _FOLDS, np.random.default_rng(seed))
        parts += [Part.of(f"within {name}", Fold(places[f.train], places[f.test], f.name)) for f in folds]
    for one, other in (("cylinders", "boxes"), ("boxes", "cylinders")):
        parts.append(Part(f"{one} to {other}", f"{one} to {other}", types[one], types[other]))
    return parts


def _places(samples: Sequence[GraspSample], names: Sequence[str]) -> Indices:
    return np.array([k for k, sample in enumerate(samples) if sample.object in names], np.intp)


_RUNNER = FoldRunner(_parts)


def _cells(settings: CrossTypeSettings, data: Collection) -> list[Cell]:
    """The usual cells; each tells the objects of no type, so that the results can."""
    known = {*settings.types.cylinders, *settings.types.boxes}
    untyped = sorted({sample.object for sample in labelled(data)} - known)
    return [Cell(cell.key, {**cell.values, "untyped": untyped}) for cell in _RUNNER.cells(settings, data)]


def _tabulate(settings: CrossTypeSettings, rows: Sequence[Row]) -> list[Row]:
    """The tables, the two directions together, and P1's figures."""
    crossed = [{**row, "table": ACROSS} for row in rows if " to " in row["table"]]
    table = score_table(settings, [*rows, *crossed])
    untyped = " ".join(rows[0]["untyped"]) if rows else ""
    return [{**row, "untyped": untyped} for row in [*table, *_published(table)]]


def _published(table: Sequence[Row]) -> list[Row]:
    rows = []
    for name, figures in PUBLISHED.items():
        beside = next((row for row in table if row["table"] == name and row["object"] == EVERYTHING), None)
        if beside is None:
            continue
        empty: Row = {**dict.fromkeys(beside), "table": name, "predictor": _P1, "object": EVERYTHING}
        for modality, (rmse, nrmse) in figures.items():
            rows.append({**empty, "modality": modality, "rmse": rmse, "nrmse_p1": nrmse})
    return rows


def _summarise(rows: Sequence[Row]) -> list[Table]:
    ours = [row for row in rows if row["predictor"] != _P1]
    untyped = rows[0]["untyped"] or "none"
    notes = [
        "P1's sugar box is not in the public data: its boxes were a snacks box (cheezit) and that one",
        f"objects of no type, left out: {untyped}",
        "fewer than 6 objects: no interval, for none would hold 95 %",
    ]
    return [*_rmse_tables(rows), *skill_tables(ours, notes)]


def _rmse_tables(rows: Sequence[Row]) -> list[Table]:
    tables = []
    for name in PUBLISHED:
        mine = [row for row in rows if row["table"] == name and row["object"] == EVERYTHING and row["modality"] != MEAN]
        who = sorted(dict.fromkeys(row["predictor"] for row in mine), key=lambda one: one == _P1)
        body = [[one, *(_rmse(mine, one, key) for key in MODALITIES)] for one in who]
        tables.append(Table(f"{name}: RMSE in counts (over P1's divisors)", ["rmse", *MODALITIES], body))
    return tables


def _rmse(rows: Sequence[Row], predictor: str, modality: str) -> str:
    row: dict[str, Any] = next(row for row in rows if row["predictor"] == predictor and row["modality"] == modality)
    scaled = "" if row["nrmse_p1"] is None else f" ({row['nrmse_p1']:.3f})"
    return f"{row['rmse']:.0f}{scaled}"


EXPERIMENT = Experiment(
    name="cross_type",
    question="How do the errors within a type of object, and from one type to the other, compare with P1's?",
    module=__name__,
    settings=CrossTypeSettings,
    presets=PRESETS,
    load=load,
    cells=_cells,
    run=_RUNNER.run,
    tabulate=_tabulate,
    summarise=_summarise,
    free=FREE,
    data_folder="vision2tactile",
)
