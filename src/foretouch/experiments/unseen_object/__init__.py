# SPDX-License-Identifier: Apache-2.0
"""Leave each object out once and predict it without a touch, and after some touches of it.

Without a touch, all grasps of the object are predicted; after k touches, all that were not touched, in `draws` random
draws of the touched ones. The draws follow from the name of the object and the number of the draw alone: they are the
same for every predictor, and 3 touches are the first of the 5. The reference of the skill is always the mean of the
other objects' labels, so that the skill shows the effect of the touches.

In these recordings a new object is also another day: touches correct for object and session together.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared import real_grasps
from foretouch.experiments.shared.predictors import (
    EARLIER,
    NETWORKS,
    PREDICTORS,
    SHRINKAGE,
    Fit,
    Fitted,
    find_predictor,
)
from foretouch.experiments.shared.skill import MODELS, skill_tables
from foretouch.learning.data import Dataset, Indices, labels_of, make_folds
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES
from foretouch.types import Float64, GraspSample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "EXPERIMENT",
    "UnseenObjectSettings",
    "draw_over_touches",
    "draw_touches",
    "left_out_cells",
    "left_out_rows",
    "summarise_touches",
    "tabulate_touches",
    "touch_draws",
    "touch_rows",
]

_KNOWN_OBJECTS_ONLY: Final = ("object_mean", "object_time_trees")
"""Predictors that cannot predict a new object."""

_LOWEST_SKILL: Final = -1.0
_OFFSET: Final = 0.12  # between markers, so that intervals do not hide each other


@dataclass(frozen=True, kw_only=True)
class UnseenObjectSettings(real_grasps.RealGraspSettings):
    """Settings of `unseen_object`."""

    seeds: tuple[int, ...] = setting((0,), "Seeds of the predictors", minimum=0)
    predictors: tuple[str, ...] = setting(
        tuple(name for name in PREDICTORS if name not in (*NETWORKS, *EARLIER, *_KNOWN_OBJECTS_ONLY)),
        "Predictors to compare",
        choices=tuple(PREDICTORS),
    )
    touches: tuple[int, ...] = setting(
        (0, 1, 3, 5, 10), "Numbers of touches of the new object", minimum=0, maximum=1000
    )
    draws: int = setting(20, "Number of random draws of the touched grasps", minimum=1, maximum=1000)
    references: tuple[str, ...] = setting(
        ("training_mean", "geometry_trees"), "Predictors that the others are compared with, after the same touches"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.touches or len(set(self.touches)) != len(self.touches):
            raise ConfigError(
                f"UnseenObjectSettings.touches: {list(self.touches)} must contain at least one value and no duplicates"
            )


def touch_draws(name: str, count: int, settings: UnseenObjectSettings) -> list[Indices]:
    """For each draw, all grasps of an object in the order in which they would be touched.

    Args:
        name: Name of the object.
        count: Number of its grasps.
        settings: Numbers of draws and touches.

    Raises:
        DatasetError: If no grasp would be left to score.
    """
    if count <= max(settings.touches):
        raise DatasetError(f"{name}: {count} grasps leave none to score after {max(settings.touches)} touches")
    code = zlib.crc32(name.encode())
    return [np.random.default_rng([code, draw]).permutation(count) for draw in range(settings.draws)]


def left_out_cells(settings: UnseenObjectSettings, data: Dataset) -> list[Cell]:
    """A cell for each predictor, seed and object that is left out."""
    return [
        Cell(f"{name}+{fold.name}+seed{seed}", {"part": fold.name, "predictor": name, "seed": seed})
        for seed, name in real_grasps.seeded_predictors(settings)
        for fold in make_folds(real_grasps.labelled(data), "object", 0)
    ]


def left_out_rows(fit: Fit, cell: Cell, settings: UnseenObjectSettings, data: Dataset) -> list[Row]:
    """Fit to all objects but the cell's, and return the `touch_rows` of that one."""
    train = [sample for sample in real_grasps.labelled(data) if sample.object != cell.values["part"]]
    test = [sample for sample in real_grasps.labelled(data) if sample.object == cell.values["part"]]
    labels = labels_of(train)
    return touch_rows(fit(train, labels, cell.values["seed"]), test, labels.mean(axis=0), settings)


def _run(cell: Cell, settings: UnseenObjectSettings, data: Dataset) -> list[Row]:
    return left_out_rows(find_predictor(cell.values["predictor"], settings.effort), cell, settings, data)


def touch_rows(
    fitted: Fitted, samples: Sequence[GraspSample], mean: Float64, settings: UnseenObjectSettings
) -> list[Row]:
    """`error_rows` of one object after each number of touches of it, each number in a table of its own.

    Args:
        fitted: Predictor that was fitted to none of these grasps.
        samples: All grasps of the object.
        mean: (50,) mean of labels, the reference of the skill [counts].
        settings: Numbers of touches and draws.
    """
    fitted.predict(samples)  # all at once, so that a baseline that is fitted in each call is fitted only once
    rows = []
    for count in settings.touches:
        tested, predicted = zip(*_predict_draws(fitted, samples, count, settings), strict=True)
        scored = [sample for draw in tested for sample in draw]
        errors = real_grasps.error_rows(scored, np.concatenate(predicted), labels_of(scored), mean)
        rows += [{"table": _table(count), "touches": count, **row} for row in errors]
    return rows


def _predict_draws(
    fitted: Fitted, samples: Sequence[GraspSample], count: int, settings: UnseenObjectSettings
) -> Iterator[tuple[list[GraspSample], Float64]]:
    """For each draw, the scored grasps and their predictions."""
    if count == 0:
        yield list(samples), fitted.predict(samples)
        return
    for order in touch_draws(samples[0].object, len(samples), settings):
        touched, rest = ([samples[k] for k in side] for side in (order[:count], np.sort(order[count:])))
        yield rest, fitted.predict_after(touched, rest)


def _table(count: int) -> str:
    return "no touch" if count == 0 else f"after {count} touch" + ("es" if count > 1 else "")


def tabulate_touches(settings: UnseenObjectSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of the rows of `touch_rows`, with the number of touches as a column."""
    touches = {row["table"]: row["touches"] for row in rows}
    return [{"touches": touches[row["table"]], **row} for row in real_grasps.score_table(settings, rows)]


def summarise_touches(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each number of touches."""
    notes = [
        f"after n touches, predictors without adaptation add n / (n + {SHRINKAGE:g}) of their mean residual, as does the mean"
    ]
    return skill_tables(rows, notes)


def draw_touches(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: all objects together above, each object below (with the released model, if it was run)."""
    predictors = list(dict.fromkeys(row["predictor"] for row in rows))
    chosen = next((name for name in MODELS if name in predictors), predictors[-1])
    objects = sorted({row["object"] for row in rows} - {real_grasps.ALL_OBJECTS})
    figure = new_figure(14.0, 7.5)
    above, below = figure.subplots(2, len(MODALITIES), sharex=True, sharey="row")
    for axes, modality in zip(above, MODALITIES, strict=True):
        subset = [row for row in rows if row["modality"] == modality and row["object"] == real_grasps.ALL_OBJECTS]
        draw_over_touches(axes, subset, "predictor", predictors)
        axes.set_title(modality)
    for axes, modality in zip(below, MODALITIES, strict=True):
        subset = [row for row in rows if row["modality"] == modality and row["predictor"] == chosen]
        draw_over_touches(axes, subset, "object", objects)
        axes.set_xlabel("touches of the new object")
    above[0].set_ylabel("skill, all objects, 95 % interval")
    below[0].set_ylabel(f"skill, {chosen}, each object")
    figure.legend(*above[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    figure.legend(*below[0].get_legend_handles_labels(), loc="outside right lower", fontsize=8)
    return [save(figure, folder / "touches.png")]


def draw_over_touches(axes: Axes, rows: Rows, column: str, names: Sequence[str], lowest: float = _LOWEST_SKILL) -> None:
    """Draw a line over touches for each name in a column, with intervals; an arrow marks values below `lowest`."""
    counts = sorted({row["touches"] for row in rows})
    for number, name in enumerate(names):
        subset = sorted((row for row in rows if row[column] == name), key=lambda row: row["touches"])
        offset = _OFFSET * (number - (len(names) - 1) / 2) if column == "predictor" else 0.0
        x = [counts.index(row["touches"]) + offset for row in subset]
        axes.plot(x, [row["skill"] for row in subset], marker="o", markersize=4, color=f"C{number}", label=name)
        for centre, row in zip(x, subset, strict=True):
            if row["skill"] < lowest:
                axes.plot(centre, lowest, marker="v", color=f"C{number}", clip_on=False)
            if row["skill_low"] is not None:
                axes.plot([centre, centre], [row["skill_low"], row["skill_high"]], color=f"C{number}", linewidth=1)
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_ylim(lowest, 1.0)
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, alpha=0.3)


EXPERIMENT = Experiment(
    name="unseen_object",
    question="How accurate are predictions on an object that was never touched, and after a few touches of it?",
    module=__name__,
    order=40,
    settings=UnseenObjectSettings,
    presets={
        "full": {"predictors": [name for name in PREDICTORS if name not in _KNOWN_OBJECTS_ONLY]},
        "quick": {},
        "smoke": {"effort": 0.1, "draws": 5},
    },
    load=real_grasps.load,
    cells=left_out_cells,
    run=_run,
    tabulate=tabulate_touches,
    summarise=summarise_touches,
    figure=draw_touches,
    resumable_settings=real_grasps.RESUMABLE,
    data_folder="vision2tactile",
)
