# SPDX-License-Identifier: Apache-2.0
"""Would more data help? Skill over the number of grasps an object, and over the number of objects.

    known objects    blocks of time of the real grasps, some grasps of each object to learn from
    new objects      each real object left out once, some of the others to learn from
    simulated        some simulated objects to learn from, the same others to be tested on

What is learned from is drawn by the seed; a smaller draw is part of a larger one. The skill compares with the mean of the labels of the
*whole* training side, so that all sizes are measured by one yardstick: with little to learn from it may be far below 0.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.framework.tables import skill_tables
from foretouch.experiments.shared.divisions import by_object, divide_objects
from foretouch.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch.experiments.shared.real_grasps import RealGraspSettings, error_rows, labelled, score_table
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.learning.data.folds import make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.comparison import BootstrapConfig
from foretouch.types import GraspSample

__all__ = ["EXPERIMENT", "LearningCurveSettings", "some_grasps", "some_objects"]

KNOWN: Final = "known objects"
NEW: Final = "new objects"
SIMULATED: Final = "simulated new objects"
_SPLITS: Final = {KNOWN: "time", NEW: "object"}
_UNITS: Final = {KNOWN: "grasps an object", NEW: "objects", SIMULATED: "objects"}


@dataclass(frozen=True, kw_only=True)
class LearningCurveSettings(BothSettings):
    """Of `learning_curve`."""

    grounds: tuple[str, ...] = setting(tuple(_UNITS), "Where it is asked", choices=tuple(_UNITS))
    predictors: tuple[str, ...] = setting(("geometry_trees", "contact"), "Who is compared", choices=tuple(PREDICTORS))
    seeds: tuple[int, ...] = setting((0, 1, 2), "Of what is learned from, and of the predictors", minimum=0)
    grasps: tuple[int, ...] = setting((5, 10, 20, 40), "Of each known object to learn from", minimum=1)
    objects: tuple[int, ...] = setting((2, 4, 7), "Real objects to learn from", minimum=1)
    simulated_objects: tuple[int, ...] = setting((5, 10, 20, 40, 80), "Simulated objects to learn from", minimum=1)
    effort: float = setting(1.0, "Share of trees and epochs", minimum=0.001, maximum=1.0)
    bootstrap: BootstrapConfig = BootstrapConfig()

    def sizes(self, ground: str) -> tuple[int, ...]:
        """How much is learned from."""
        return {KNOWN: self.grasps, NEW: self.objects, SIMULATED: self.simulated_objects}[ground]


def some_grasps(samples: Sequence[GraspSample], count: int, seed: int) -> list[GraspSample]:
    """`count` grasps of each object.

    Raises:
        DatasetError: If an object has fewer.
    """
    chosen: list[GraspSample] = []
    for mine in by_object(samples):
        if len(mine) < count:
            raise DatasetError(f"learning_curve: {mine[0].object} has {len(mine)} grasps, fewer than {count}")
        order = np.random.default_rng([zlib.crc32(mine[0].object.encode()), seed]).permutation(len(mine))
        chosen += [mine[k] for k in order[:count]]
    return chosen


def some_objects(samples: Sequence[GraspSample], count: int, seed: int) -> list[GraspSample]:
    """All grasps of `count` objects.

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
        train, test = divide_objects(labelled(data.simulated), max(settings.simulated_objects), 0)
    else:
        real = labelled(data.real)
        (fold,) = (fold for fold in make_folds(real, _SPLITS[ground], 0) if fold.name == part)
        train, test = ([real[k] for k in side] for side in (fold.train, fold.test))
    learned = some_grasps(train, size, seed) if ground == KNOWN else some_objects(train, size, seed)
    fitted = find_predictor(cell.values["predictor"], settings.effort)(learned, labels_of(learned), seed)
    return error_rows(test, fitted.predict(test), labels_of(test), labels_of(train).mean(axis=0))


def _tabulate(settings: LearningCurveSettings, rows: Sequence[Row]) -> list[Row]:
    told = {row["table"]: {"ground": row["ground"], "size": row["size"]} for row in rows}
    how = RealGraspSettings(
        predictors=settings.predictors,
        seeds=settings.seeds,
        references=settings.predictors[:1],
        bootstrap=settings.bootstrap,
    )
    return [{**told[row["table"]], **row} for row in score_table(how, rows)]


def _summarise(rows: Sequence[Row]) -> list[Table]:
    return skill_tables(rows, ["the mean is that of the whole training side, whatever was learned from"])


EXPERIMENT = Experiment(
    name="learning_curve",
    question="Would more grasps of an object, or more objects, make predictions better?",
    module=__name__,
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
    prepare=prepare_both,
    free=("grounds", "predictors", "seeds", "grasps", "objects", "bootstrap"),
    data_folder="vision2tactile",
)
