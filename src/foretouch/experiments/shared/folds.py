# SPDX-License-Identifier: Apache-2.0
"""Fit each predictor to some grasps and test it on others, fold by fold; and split samples by object."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared import real_grasps
from foretouch.experiments.shared.predictors import find_predictor
from foretouch.experiments.shared.skill import draw_skill_figure, skill_tables
from foretouch.learning.data import Dataset, Fold, labels_of, make_folds
from foretouch.types import GraspSample


@dataclass(frozen=True, eq=False)
class TableFold:
    """A fold and the table of the results that it belongs to; its name is unique in the table."""

    table: str
    fold: Fold


MakeFolds = Callable[[Any, Sequence[GraspSample], int], list[TableFold]]


@dataclass(frozen=True)
class FoldRunner:
    """`cells` and `run` of an experiment that consists of folds."""

    folds: MakeFolds  # (settings, labelled samples, seed) to the folds; deterministic

    def cells(self, settings: real_grasps.RealGraspSettings, data: Dataset) -> list[Cell]:
        """A cell for each fold, predictor and seed."""
        samples = real_grasps.labelled(data)
        return [
            Cell(
                "+".join((name, one.table, one.fold.name, f"seed{seed}")).replace(" ", "_"),
                {"table": one.table, "part": one.fold.name, "predictor": name, "seed": seed},
            )
            for seed, name in real_grasps.seeded_predictors(settings)
            for one in self.folds(settings, samples, seed)
        ]

    def run(self, cell: Cell, settings: real_grasps.RealGraspSettings, data: Dataset) -> list[Row]:
        """Fit and test once."""
        samples = real_grasps.labelled(data)
        table, part, seed = (cell.values[key] for key in ("table", "part", "seed"))
        folds = [one.fold for one in self.folds(settings, samples, seed) if one.table == table]
        train, test = split_by_fold(samples, folds, part)
        labels = labels_of(train)
        fitted = find_predictor(cell.values["predictor"], settings.effort)(train, labels, seed)
        return real_grasps.error_rows(test, fitted.predict(test), labels_of(test), labels.mean(axis=0))


def split_experiment(*, name: str, question: str, module: str, split: str, order: int) -> Experiment[Any, Any]:
    """The experiment that tests all predictors on the folds of a named split, as one table.

    Args:
        name: Name of the experiment.
        question: What it answers.
        module: Module that holds the `EXPERIMENT`.
        split: One of `foretouch.learning.data.folds.SPLITS`.
        order: Position in lists of experiments.
    """

    def folds(settings: real_grasps.RealGraspSettings, samples: Sequence[GraspSample], seed: int) -> list[TableFold]:
        del settings
        if not samples:
            raise DatasetError("experiment: no sample is labelled")
        return [TableFold(split, fold) for fold in make_folds(samples, split, seed)]

    runner = FoldRunner(folds)
    return Experiment(
        name=name,
        question=question,
        module=module,
        order=order,
        settings=real_grasps.RealGraspSettings,
        presets=real_grasps.PRESETS,
        load=real_grasps.load,
        cells=runner.cells,
        run=runner.run,
        tabulate=real_grasps.score_table,
        summarise=skill_tables,
        figure=draw_skill_figure,
        resumable_settings=real_grasps.RESUMABLE,
        data_folder="vision2tactile",
    )


def split_by_fold(
    samples: Sequence[GraspSample], folds: Sequence[Fold], name: str
) -> tuple[list[GraspSample], list[GraspSample]]:
    """Training and test samples of the fold of a name."""
    (fold,) = (one for one in folds if one.name == name)
    return [samples[k] for k in fold.train], [samples[k] for k in fold.test]


def split_objects(
    samples: Sequence[GraspSample], train_objects: int, seed: int
) -> tuple[list[GraspSample], list[GraspSample]]:
    """Samples of `train_objects` randomly drawn objects, and those of the others.

    Raises:
        DatasetError: If no object is left for testing.
    """
    names = sorted({sample.object for sample in samples})
    if train_objects >= len(names):
        raise DatasetError(f"split: of {len(names)} objects, {train_objects} for training leave none to test on")
    chosen = {names[k] for k in np.random.default_rng(seed).permutation(len(names))[:train_objects]}
    return [one for one in samples if one.object in chosen], [one for one in samples if one.object not in chosen]


def by_object(samples: Sequence[GraspSample]) -> list[list[GraspSample]]:
    """Samples of each object, objects sorted by name."""
    names = sorted({sample.object for sample in samples})
    return [[sample for sample in samples if sample.object == name] for name in names]
