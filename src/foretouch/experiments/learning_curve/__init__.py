# SPDX-License-Identifier: Apache-2.0
"""Skill over the number of training grasps per object, and over the number of training objects.

    known objects            blocks of time of the real grasps; some grasps of each object for training
    new objects              each real object left out once; some of the others for training
    simulated new objects    some simulated objects for training; the same other ones for testing

Training subsets are drawn by the seed; a smaller one is part of a larger one. The reference of the skill is the mean of
the labels of the *full* training set at every size, so that all sizes are comparable: for small ones the skill may be
far below 0.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared.folds import by_object, split_by_fold, split_objects
from foretouch.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch.experiments.shared.real_grasps import ALL_OBJECTS, RealGraspSettings, error_rows, labelled, score_table
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.experiments.shared.skill import skill_tables
from foretouch.learning.data import labels_of, make_folds
from foretouch.learning.evaluation.metrics import BootstrapConfig
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES
from foretouch.types import GraspSample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["EXPERIMENT", "LearningCurveSettings", "draw_curve", "some_grasps", "some_objects"]

KNOWN: Final = "known objects"
NEW: Final = "new objects"
SIMULATED: Final = "simulated new objects"
_SPLITS: Final = {KNOWN: "time", NEW: "object"}
_UNITS: Final = {KNOWN: "grasps an object", NEW: "objects", SIMULATED: "objects"}  # in the column `table`
_LOWEST_SKILL: Final = -0.6
_OFFSET: Final = 0.04  # between markers, as a share of the size, so that intervals do not hide each other


@dataclass(frozen=True, kw_only=True)
class LearningCurveSettings(BothSettings):
    """Settings of `learning_curve`."""

    grounds: tuple[str, ...] = setting(tuple(_UNITS), "Data and splits to test on", choices=tuple(_UNITS))
    predictors: tuple[str, ...] = setting(
        ("geometry_trees", "contact"), "Predictors to compare", choices=tuple(PREDICTORS)
    )
    seeds: tuple[int, ...] = setting((0, 1, 2), "Seeds of the training subsets and of the predictors", minimum=0)
    grasps: tuple[int, ...] = setting((5, 10, 20, 40), "Training grasps of each known object", minimum=1)
    objects: tuple[int, ...] = setting((2, 4, 7), "Numbers of real training objects", minimum=1)
    simulated_objects: tuple[int, ...] = setting(
        (5, 10, 20, 40, 80), "Numbers of simulated training objects", minimum=1
    )
    effort: float = setting(1.0, "Share of trees and epochs", minimum=0.001, maximum=1.0)
    bootstrap: BootstrapConfig = BootstrapConfig()

    def sizes(self, ground: str) -> tuple[int, ...]:
        """Training sizes of a ground."""
        return {KNOWN: self.grasps, NEW: self.objects, SIMULATED: self.simulated_objects}[ground]


def some_grasps(samples: Sequence[GraspSample], count: int, seed: int) -> list[GraspSample]:
    """Draw `count` grasps of each object.

    Raises:
        DatasetError: If an object has fewer.
    """
    chosen: list[GraspSample] = []
    for subset in by_object(samples):
        if len(subset) < count:
            raise DatasetError(f"learning_curve: {subset[0].object} has {len(subset)} grasps, fewer than {count}")
        order = np.random.default_rng([zlib.crc32(subset[0].object.encode()), seed]).permutation(len(subset))
        chosen += [subset[k] for k in order[:count]]
    return chosen


def some_objects(samples: Sequence[GraspSample], count: int, seed: int) -> list[GraspSample]:
    """Draw `count` objects and return all their grasps.

    Raises:
        DatasetError: If there are fewer.
    """
    groups = by_object(samples)
    if len(groups) < count:
        raise DatasetError(f"learning_curve: {len(groups)} objects are fewer than {count}")
    order = np.random.default_rng(seed).permutation(len(groups))
    return [sample for k in order[:count] for sample in groups[k]]


def _cells(settings: LearningCurveSettings, data: RealAndSimulated) -> list[Cell]:
    return [
        Cell(
            f"{name}+{ground}+{size}+{part}+seed{seed}".replace(" ", "_"),
            {
                "table": f"{ground}, {size} {_UNITS[ground]}",
                "ground": ground,
                "size": size,
                "part": part,
                "predictor": name,
                "seed": seed,
            },
        )
        for ground in settings.grounds
        for size in settings.sizes(ground)
        for seed in settings.seeds
        for part in _parts(ground, data)
        for name in settings.predictors
    ]


def _parts(ground: str, data: RealAndSimulated) -> Iterator[str]:
    if ground == SIMULATED:
        yield "all"
    else:
        yield from (fold.name for fold in make_folds(labelled(data.real), _SPLITS[ground], 0))


def _run(cell: Cell, settings: LearningCurveSettings, data: RealAndSimulated) -> list[Row]:
    ground, size, part, seed = (cell.values[key] for key in ("ground", "size", "part", "seed"))
    if ground == SIMULATED:
        train, test = split_objects(labelled(data.simulated), max(settings.simulated_objects), 0)
    else:
        real = labelled(data.real)
        train, test = split_by_fold(real, make_folds(real, _SPLITS[ground], 0), part)
    chosen = some_grasps(train, size, seed) if ground == KNOWN else some_objects(train, size, seed)
    fitted = find_predictor(cell.values["predictor"], settings.effort)(chosen, labels_of(chosen), seed)
    return error_rows(test, fitted.predict(test), labels_of(test), labels_of(train).mean(axis=0))


def _tabulate(settings: LearningCurveSettings, rows: Sequence[Row]) -> list[Row]:
    columns = {row["table"]: {"ground": row["ground"], "size": row["size"]} for row in rows}
    scoring = RealGraspSettings(
        predictors=settings.predictors,
        seeds=settings.seeds,
        references=settings.predictors[:1],
        bootstrap=settings.bootstrap,
    )
    return [{**columns[row["table"]], **row} for row in score_table(scoring, rows)]


def _summarise(rows: Sequence[Row]) -> list[Table]:
    return skill_tables(rows, ["the mean of the training labels is that of the full training set at every size"])


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `curve.png`: grounds below each other, modalities side by side."""
    grounds = list(dict.fromkeys(row["ground"] for row in rows))
    predictors = list(dict.fromkeys(row["predictor"] for row in rows))
    figure = new_figure(14.0, 0.6 + 3.0 * len(grounds))
    grid = figure.subplots(len(grounds), len(MODALITIES), squeeze=False, sharey="row")
    for line, ground in zip(grid, grounds, strict=True):
        for axes, modality in zip(line, MODALITIES, strict=True):
            key = (ground, modality, ALL_OBJECTS)
            subset = [row for row in rows if (row["ground"], row["modality"], row["object"]) == key]
            draw_curve(axes, subset, predictors)
            axes.set_title(f"{ground}: {modality}", fontsize=9)
            axes.set_xlabel("training grasps per object" if ground == KNOWN else "training objects")
        line[0].set_ylabel("skill, 95 % interval")
    grid[0, -1].legend(fontsize=8)
    return [save(figure, folder / "curve.png")]


def draw_curve(axes: Axes, rows: Rows, predictors: Sequence[str]) -> None:
    """Draw a line for each predictor over the training size on a logarithmic scale."""
    sizes = sorted({row["size"] for row in rows})
    for number, name in enumerate(predictors):
        subset = sorted((row for row in rows if row["predictor"] == name), key=lambda row: row["size"])
        x = [row["size"] * (1.0 + _OFFSET * number) for row in subset]
        axes.plot(x, [row["skill"] for row in subset], marker="o", markersize=4, color=f"C{number}", label=name)
        for centre, row in zip(x, subset, strict=True):
            if row["skill_low"] is not None:
                axes.plot([centre, centre], [row["skill_low"], row["skill_high"]], color=f"C{number}", linewidth=1)
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
    axes.set_ylim(max(_LOWEST_SKILL, axes.get_ylim()[0]), None)
    axes.grid(visible=True, alpha=0.3)


EXPERIMENT = Experiment(
    name="learning_curve",
    question="Do more grasps per object, or more objects, improve predictions?",
    module=__name__,
    order=100,
    settings=LearningCurveSettings,
    presets={
        "full": {},
        "quick": {"effort": 0.34},
        "smoke": {
            "samples": 100,
            "seeds": [0],
            "grasps": [10],
            "objects": [7],
            "simulated_objects": [20],
            "effort": 0.05,
            "bootstrap.draws": 200,
        },
    },
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    figure=_draw,
    prepare=prepare_both,
    resumable_settings=("grounds", "predictors", "seeds", "grasps", "objects", "bootstrap"),
    data_folder="vision2tactile",
)
