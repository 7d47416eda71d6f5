# SPDX-License-Identifier: Apache-2.0
"""How well is touch predicted on an object that was never felt, and after a few touches of it?

Each object is left out once. Without a touch the predictor answers for all its grasps; after k touches it answers for
those that were not touched, in `draws` draws of which ones those are. The draws follow from the object's name and the
draw's number alone: they are the same for every predictor, and the touches of 3 are the first of the touches of 5.
The skill compares with the mean of the other objects' labels throughout, so that it tells what the touches are worth.

With these recordings a new object is also another day: what a touch corrects is object and session together.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.framework.tables import skill_tables
from foretouch.experiments.shared.predictors import NETWORKS, PREDICTORS, SHRINKAGE, Fitted, find_predictor
from foretouch.experiments.shared.real_grasps import (
    FREE,
    RealGraspSettings,
    error_rows,
    labelled,
    load,
    score_table,
    seeded_predictors,
)
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.folds import Indices, make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "UnseenObjectSettings", "summarise_touches", "tabulate_touches", "touch_draws", "touch_rows"]

_KNOW_ONLY_OBJECTS: Final = ("object_mean", "object_time_trees")
"""Of a new object they know nothing."""


@dataclass(frozen=True, kw_only=True)
class UnseenObjectSettings(RealGraspSettings):
    """Of `unseen_object`."""

    seeds: tuple[int, ...] = setting((0,), "Of the predictors", minimum=0)
    predictors: tuple[str, ...] = setting(
        tuple(name for name in PREDICTORS if name not in (*NETWORKS, *_KNOW_ONLY_OBJECTS)),
        "Who is compared",
        choices=tuple(PREDICTORS),
    )
    touches: tuple[int, ...] = setting((0, 1, 3, 5, 10), "Touches of the new object", minimum=0, maximum=1000)
    draws: int = setting(20, "How often the touched grasps are drawn", minimum=1, maximum=1000)
    references: tuple[str, ...] = setting(
        ("training_mean", "geometry_trees"), "Whom the others are compared with, after as many touches"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.touches or len(set(self.touches)) != len(self.touches):
            raise ConfigError(f"UnseenObjectSettings.touches: {list(self.touches)} must hold at least one, each once")


def touch_draws(name: str, count: int, settings: UnseenObjectSettings) -> list[Indices]:
    """For each draw, all grasps of an object in the order in which they would be touched.

    Args:
        name: Of the object.
        count: Of its grasps.
        settings: How many draws, and of how many touches.

    Raises:
        DatasetError: If no grasp would be left to be scored.
    """
    if count <= max(settings.touches):
        raise DatasetError(f"{name}: {count} grasps leave none to score after {max(settings.touches)} touches")
    code = zlib.crc32(name.encode())
    return [np.random.default_rng([code, draw]).permutation(count) for draw in range(settings.draws)]


def _cells(settings: UnseenObjectSettings, data: Collection) -> list[Cell]:
    folds = make_folds(labelled(data), "object", 0)
    return [
        Cell(f"{name}+{fold.name}+seed{seed}", {"part": fold.name, "predictor": name, "seed": seed})
        for seed, name in seeded_predictors(settings)
        for fold in folds
    ]


def _run(cell: Cell, settings: UnseenObjectSettings, data: Collection) -> list[Row]:
    samples = labelled(data)
    held = [sample for sample in samples if sample.object == cell.values["part"]]
    train = [sample for sample in samples if sample.object != cell.values["part"]]
    labels, seed = labels_of(train), cell.values["seed"]
    fitted = find_predictor(cell.values["predictor"], settings.effort)(train, labels, seed)
    return touch_rows(fitted, held, labels.mean(axis=0), settings)


def touch_rows(fitted: Fitted, held: Sequence[GraspSample], mean: Float64, settings: UnseenObjectSettings) -> list[Row]:
    """`error_rows` of one object after each number of touches of it, in tables of their own.

    Args:
        fitted: Was not fitted to any of these grasps.
        held: All grasps of the object.
        mean: (50,) of the labels that the skill compares with [counts].
        settings: How many touches, in how many draws.
    """
    fitted.predict(held)  # at once, so that a predictor that is fitted anew for each question is fitted once
    rows = []
    for count in settings.touches:
        tested, predicted = zip(*_after(fitted, held, count, settings), strict=True)
        everyone = [sample for draw in tested for sample in draw]
        errors = error_rows(everyone, np.concatenate(predicted), labels_of(everyone), mean)
        rows += [{"table": _table(count), "touches": count, **row} for row in errors]
    return rows


def _after(
    fitted: Fitted, held: Sequence[GraspSample], count: int, settings: UnseenObjectSettings
) -> Iterator[tuple[list[GraspSample], Float64]]:
    """For each draw, the grasps that are scored and what is predicted for them."""
    if count == 0:
        yield list(held), fitted.predict(held)
        return
    for order in touch_draws(held[0].object, len(held), settings):
        touched, rest = ([held[k] for k in side] for side in (order[:count], np.sort(order[count:])))
        yield rest, fitted.predict_after(touched, rest)


def _table(count: int) -> str:
    return "no touch" if count == 0 else f"after {count} touch" + ("es" if count > 1 else "")


def tabulate_touches(settings: UnseenObjectSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of the rows of `touch_rows`, with the number of touches as a column."""
    touches = {row["table"]: row["touches"] for row in rows}
    return [{"touches": touches[row["table"]], **row} for row in score_table(settings, rows)]


def summarise_touches(rows: Sequence[Row]) -> list[Table]:
    """One table of skills for each number of touches."""
    notes = [
        f"after n touches, who has no rule of its own adds n / (n + {SHRINKAGE:g}) of its mean residual; so does the mean"
    ]
    return skill_tables(rows, notes)


EXPERIMENT = Experiment(
    name="unseen_object",
    question="How well is touch predicted on an object that was never felt, and after a few touches of it?",
    module=__name__,
    settings=UnseenObjectSettings,
    presets={
        "full": {"predictors": [name for name in PREDICTORS if name not in _KNOW_ONLY_OBJECTS]},
        "quick": {},
        "smoke": {"effort": 0.1, "draws": 5},
    },
    load=load,
    cells=_cells,
    run=_run,
    tabulate=tabulate_touches,
    summarise=summarise_touches,
    free=FREE,
    data_folder="vision2tactile",
)
