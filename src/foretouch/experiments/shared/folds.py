# SPDX-License-Identifier: Apache-2.0
"""Experiments that fit each predictor to some grasps and test it on others, fold by fold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.experiments.shared.predictors import find_predictor
from foretouch.experiments.shared.real_grasps import RealGraspSettings, error_rows, labelled, seeded_predictors
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.folds import Fold, Indices, make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.types import GraspSample

__all__ = ["FoldRunner", "Part", "split_parts"]


@dataclass(frozen=True, eq=False)
class Part:
    """One fold of one table.

    Attributes:
        table: Its table in the results.
        name: Unique in the table.
        train, test: Places of the samples.
    """

    table: str
    name: str
    train: Indices
    test: Indices

    @classmethod
    def of(cls, table: str, fold: Fold) -> Part:
        """A fold as a part of a table."""
        return cls(table, fold.name, fold.train, fold.test)


MakeParts = Callable[[Any, Sequence[GraspSample], int], list[Part]]


@dataclass(frozen=True)
class FoldRunner:
    """`cells` and `run` of an experiment, from the parts that it is made of.

    Attributes:
        parts: (settings, labelled samples, seed) to the parts, the same for the same arguments.
    """

    parts: MakeParts

    def cells(self, settings: RealGraspSettings, data: Collection) -> list[Cell]:
        """A cell for each part, predictor and seed."""
        samples = labelled(data)
        return [
            Cell(
                "+".join((name, part.table, part.name, f"seed{seed}")).replace(" ", "_"),
                {"table": part.table, "part": part.name, "predictor": name, "seed": seed},
            )
            for seed, name in seeded_predictors(settings)
            for part in self.parts(settings, samples, seed)
        ]

    def run(self, cell: Cell, settings: RealGraspSettings, data: Collection) -> list[Row]:
        """Fit and test once."""
        samples = labelled(data)
        table, name, seed = (cell.values[key] for key in ("table", "part", "seed"))
        (part,) = (p for p in self.parts(settings, samples, seed) if (p.table, p.name) == (table, name))
        train, test = ([samples[k] for k in side] for side in (part.train, part.test))
        labels = labels_of(train)
        fitted = find_predictor(cell.values["predictor"], settings.effort)(train, labels, seed)
        return error_rows(test, fitted.predict(test), labels_of(test), labels.mean(axis=0))


def split_parts(split: str) -> MakeParts:
    """The folds of a named split of all samples, as one table.

    Args:
        split: Out of `foretouch.learning.data.folds.SPLITS`.
    """

    def parts(settings: RealGraspSettings, samples: Sequence[GraspSample], seed: int) -> list[Part]:
        del settings
        if not samples:
            raise DatasetError("experiment: no sample is labelled")
        return [Part.of(split, fold) for fold in make_folds(samples, split, seed)]

    return parts
