# SPDX-License-Identifier: Apache-2.0
"""P1's tables: five folds within cylinders and within boxes, and training on one type to test on the other.

P1 recorded a crisps can and a coffee can, a snacks box and a sugar box. The sugar box is not in the public data:
`p1_boxes` would have a single object and is left out, and `boxes` are all boxes of the data. P1 does not state in which
direction it crossed the types, so its errors are listed beside those of both directions together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared import real_grasps
from foretouch.experiments.shared.folds import FoldRunner, TableFold
from foretouch.experiments.shared.skill import draw_skill_figure, skill_tables
from foretouch.learning.data import Dataset, Fold, Indices, random_folds
from foretouch.learning.evaluation.metrics import MEAN
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES
from foretouch.types import GraspSample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["EXPERIMENT", "PUBLISHED", "CrossTypeSettings", "draw_errors"]

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
"""P1, sections III and IV: RMSE [counts] and over its divisors, by the closest of our tables."""

_P1: Final = "P1 (published)"
_FOLDS: Final = 5
_OFFSET: Final = 0.1  # between markers, so that they do not hide each other


@dataclass(frozen=True, kw_only=True)
class ObjectTypes(Settings):
    """Types of the objects, by their names in the dataset."""

    cylinders: tuple[str, ...] = setting(("campbells", "coffee", "pringles"), "Cans")
    boxes: tuple[str, ...] = setting(("cheezit", "spam", "wood"), "Boxes and blocks")
    p1_cylinders: tuple[str, ...] = setting(("coffee", "pringles"), "Cans that P1 was trained on")

    def __post_init__(self) -> None:
        super().__post_init__()
        if both := sorted(set(self.cylinders) & set(self.boxes)):
            raise ConfigError(f"ObjectTypes.boxes: {both[0]!r} is a cylinder as well")


@dataclass(frozen=True, kw_only=True)
class CrossTypeSettings(real_grasps.RealGraspSettings):
    """Settings of `cross_type`."""

    types: ObjectTypes = ObjectTypes()


def _folds(settings: CrossTypeSettings, samples: Sequence[GraspSample], seed: int) -> list[TableFold]:
    types = {name: _index(samples, names) for name, names in settings.types.to_mapping().items()}
    for name in ("cylinders", "boxes"):
        if not len(types[name]):
            raise DatasetError(f"cross_type: none of the objects is among types.{name}")
    result = []
    for name, index in types.items():
        if len(index) < _FOLDS:
            continue
        folds = random_folds(len(index), _FOLDS, np.random.default_rng(seed))
        result += [TableFold(f"within {name}", Fold(index[f.train], index[f.test], f.name)) for f in folds]
    for one, other in (("cylinders", "boxes"), ("boxes", "cylinders")):
        table = f"{one} to {other}"
        result.append(TableFold(table, Fold(types[one], types[other], table)))
    return result


def _index(samples: Sequence[GraspSample], names: Sequence[str]) -> Indices:
    return np.array([k for k, sample in enumerate(samples) if sample.object in names], np.intp)


_RUNNER = FoldRunner(_folds)


def _cells(settings: CrossTypeSettings, data: Dataset) -> list[Cell]:
    """The cells of all folds; each lists the objects of no type, as the results do."""
    known = {*settings.types.cylinders, *settings.types.boxes}
    untyped = sorted({sample.object for sample in real_grasps.labelled(data)} - known)
    return [Cell(cell.key, {**cell.values, "untyped": untyped}) for cell in _RUNNER.cells(settings, data)]


def _tabulate(settings: CrossTypeSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of each table, of both directions together, and P1's published errors."""
    crossed = [{**row, "table": ACROSS} for row in rows if " to " in row["table"]]
    table = real_grasps.score_table(settings, [*rows, *crossed])
    untyped = " ".join(rows[0]["untyped"]) if rows else ""
    return [{**row, "untyped": untyped} for row in [*table, *_published(table)]]


def _published(table: Sequence[Row]) -> list[Row]:
    rows = []
    for name, figures in PUBLISHED.items():
        beside = next((row for row in table if row["table"] == name and row["object"] == real_grasps.ALL_OBJECTS), None)
        if beside is None:
            continue
        empty: Row = {**dict.fromkeys(beside), "table": name, "predictor": _P1, "object": real_grasps.ALL_OBJECTS}
        for modality, (rmse, nrmse) in figures.items():
            rows.append({**empty, "modality": modality, "rmse": rmse, "nrmse_p1": nrmse})
    return rows


def _summarise(rows: Sequence[Row]) -> list[Table]:
    ours = [row for row in rows if row["predictor"] != _P1]
    untyped = rows[0]["untyped"] or "none"
    notes = [
        "P1's boxes were a snacks box (cheezit) and a sugar box, which is not in the public data",
        f"objects of no type, left out: {untyped}",
        "fewer than 6 objects: no interval, since none would reach a coverage of 95 %",
    ]
    return [*_rmse_tables(rows), *skill_tables(ours, notes)]


def _rmse_tables(rows: Sequence[Row]) -> list[Table]:
    tables = []
    for name in PUBLISHED:
        shown = [
            r for r in rows if (r["table"], r["object"]) == (name, real_grasps.ALL_OBJECTS) and r["modality"] != MEAN
        ]
        predictors = sorted(dict.fromkeys(row["predictor"] for row in shown), key=lambda one: one == _P1)
        body = [[one, *(_rmse(shown, one, key) for key in MODALITIES)] for one in predictors]
        tables.append(Table(f"{name}: RMSE in counts (over P1's divisors)", ["rmse", *MODALITIES], body))
    return tables


def _rmse(rows: Sequence[Row], predictor: str, modality: str) -> str:
    row: dict[str, Any] = next(row for row in rows if row["predictor"] == predictor and row["modality"] == modality)
    scaled = "" if row["nrmse_p1"] is None else f" ({row['nrmse_p1']:.3f})"
    return f"{row['rmse']:.0f}{scaled}"


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `rmse.png`, the tables that P1 has too, and `skill.png`, all tables."""
    together = [row for row in rows if row["object"] == real_grasps.ALL_OBJECTS]
    tables = list(dict.fromkeys(row["table"] for row in together if row["predictor"] == _P1))
    figure = new_figure(12.0, 3.4)
    panels = figure.subplots(1, len(MODALITIES), sharey=False)
    for axes, modality in zip(panels, MODALITIES, strict=True):
        draw_errors(axes, [r for r in together if r["modality"] == modality and r["table"] in tables], tables)
        axes.set_title(modality)
    panels[0].set_ylabel("RMSE [counts]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return [save(figure, folder / "rmse.png"), *draw_skill_figure(rows, folder)]


def draw_errors(axes: Axes, rows: Rows, tables: Sequence[str]) -> None:
    """Draw the RMSE of each predictor over the tables; published errors are black."""
    names = list(dict.fromkeys(row["predictor"] for row in rows))
    ours = [name for name in names if name != _P1]
    for number, name in enumerate(names):
        subset = [row for row in rows if row["predictor"] == name]
        colour, marker = ("black", "*") if name == _P1 else (f"C{number}", "o")
        offset = 0.0 if name == _P1 else _OFFSET * (ours.index(name) - (len(ours) - 1) / 2)
        x = [tables.index(row["table"]) + offset for row in subset]
        axes.plot(x, [row["rmse"] for row in subset], marker, color=colour, label=name, markersize=6)
    axes.set_xticks(range(len(tables)), [name.replace(" ", "\n", 1) for name in tables], fontsize=8)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.15)
    axes.grid(visible=True, axis="y", alpha=0.3)


EXPERIMENT = Experiment(
    name="cross_type",
    question="How do the errors within one object type and across types compare with those published in P1?",
    module=__name__,
    order=30,
    settings=CrossTypeSettings,
    presets=real_grasps.PRESETS,
    load=real_grasps.load,
    cells=_cells,
    run=_RUNNER.run,
    tabulate=_tabulate,
    summarise=_summarise,
    figure=_draw,
    resumable_settings=real_grasps.RESUMABLE,
    data_folder="vision2tactile",
)
