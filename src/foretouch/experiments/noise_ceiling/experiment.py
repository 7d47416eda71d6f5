# SPDX-License-Identifier: Apache-2.0
"""How much of a touch can be told from cloud and grasp at all, and how much of that do predictors tell?

Test grasps are repeated with what no camera sees drawn anew (`repeats`). With y_r the n repeats of grasp i, m their mean,
s² their variance (n - 1), p a prediction and µ the mean of the training labels, each per value,

    of the best prediction, the mean of all repeats:   S_i = s²                                (1)
    of a predictor:                                    S_i = (p - m)² + s² (1 - 1/n)           (2)
    of the training mean:                              R_i = (µ - m)² + s² (1 - 1/n)           (3)

are free of bias for the squared error that one new execution would give, however few the repeats: in eqs. 2 and 3 the
mean of n repeats lies s²/n from the true one. Skill is 1 - sum S / sum R as everywhere. What the repeats keep
is the object itself, its pose and its cloud: more than a model gets, so the ceiling is an upper bound. A predictor's
`share` is its skill over the ceiling's, on the same repeats. With `split: object` there is a second ceiling, for those
who never touched the object: its material and its day are hidden too, and predictors are measured by that one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.noise_ceiling.repeats import CAUSES, STRANGER, Repeater
from foretouch.experiments.noise_ceiling.table import ceiling_rows, ceiling_tables
from foretouch.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch.experiments.shared.simulated_data import (
    SimulatedGrasps,
    SimulatedSettings,
    load_simulated,
    prepare_simulated,
)
from foretouch.learning.data.training_set import labels_of
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "NoiseCeilingSettings"]

_BLOCK: Final = 10  # grasps a cell
_ALL: Final = "all"


@dataclass(frozen=True, kw_only=True)
class NoiseCeilingSettings(SimulatedSettings):
    """Of `noise_ceiling`."""

    grasps: int = setting(200, "Test grasps that are repeated", minimum=2, maximum=100_000)
    repeats: int = setting(20, "Of each", minimum=2, maximum=10_000)
    alone: int = setting(60, "Of these grasps, those repeated with one cause at a time as well", minimum=0)
    split: str = setting(
        "labels",
        "labels: 200 grasps an object are tested; object: a fifth of the objects",
        choices=("labels", "object"),
    )
    predictors: tuple[str, ...] = setting(
        ("object_mean", "geometry_trees", "contact"), "Who is compared with the ceiling", choices=tuple(PREDICTORS)
    )
    seed: int = setting(0, "Of the predictors", minimum=0)
    effort: float = setting(
        1.0, "Share of trees and epochs; below 1 only to try things out", minimum=0.001, maximum=1.0
    )
    draws: int = setting(2000, "Resamples of the grasps for the intervals", minimum=100, maximum=1_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.alone > self.grasps:
            raise ConfigError(f"NoiseCeilingSettings.alone: {self.alone} is above grasps, {self.grasps}")


def _sides(settings: NoiseCeilingSettings, data: SimulatedGrasps) -> tuple[list[GraspSample], list[GraspSample]]:
    """Those trained on, and those that are repeated: evenly from the test side."""
    collection = data.collection
    part = collection.parts(settings.split)[0]
    train, test = (
        [collection.samples[k] for k in collection.index(ids)] for ids in (part.train + part.unlabelled, part.test)
    )
    if settings.grasps > len(test):
        raise DatasetError(f"{collection.name}: {len(test)} test grasps are fewer than grasps, {settings.grasps}")
    chosen = np.linspace(0, len(test) - 1, settings.grasps).round().astype(int)
    return train, [test[k] for k in chosen]


def _cells(settings: NoiseCeilingSettings, data: SimulatedGrasps) -> list[Cell]:
    del data
    whole = [_ALL, STRANGER] if settings.split == "object" else [_ALL]
    blocks = [(cause, first) for cause in whole for first in range(0, settings.grasps, _BLOCK)]
    blocks += [(cause, first) for cause in CAUSES for first in range(0, settings.alone, _BLOCK)]
    repeated = [
        Cell(f"repeats+{cause}+{first}", {"what": "repeats", "name": cause, "first": first}) for cause, first in blocks
    ]
    asked = [Cell(f"predictor+{name}", {"what": "predictor", "name": name}) for name in settings.predictors]
    return repeated + asked


def _run(cell: Cell, settings: NoiseCeilingSettings, data: SimulatedGrasps) -> list[Row]:
    train, test = _sides(settings, data)
    labels = labels_of(train)
    if cell.values["what"] == "predictor":
        fitted = find_predictor(cell.values["name"], settings.effort)(train, labels, settings.seed)
        return [
            {"id": sample.id, "predicted": row.tolist()} for sample, row in zip(test, fitted.predict(test), strict=True)
        ]
    cause, first = cell.values["name"], cell.values["first"]
    hidden = {_ALL: frozenset(CAUSES), STRANGER: frozenset({*CAUSES, STRANGER})}.get(cause, frozenset({cause}))
    end = settings.alone if cause in CAUSES else settings.grasps
    grasps = test[first : min(first + _BLOCK, end)]
    return list(_repeated(Repeater(data.scene, hidden), grasps, settings.repeats, labels.mean(axis=0)))


def _repeated(repeater: Repeater, grasps: Sequence[GraspSample], count: int, mean: Float64) -> Iterator[Row]:
    for sample in grasps:
        made = repeater.repeat(int(sample.extra["slot"]), int(sample.extra["attempt"]), count)
        centre, spread = made.touches.mean(axis=0), made.touches.var(axis=0, ddof=1)
        share = 1.0 - 1.0 / len(made.touches)
        yield {
            "id": sample.id,
            "object": sample.object,
            "repeats": len(made.touches),
            "mean": centre.tolist(),
            "rest": (share * spread).tolist(),  # of eqs. 2 and 3
            "within": spread.tolist(),  # eq. 1
            "within_change": (made.touches - made.tares).var(axis=0, ddof=1).tolist(),
            "reference": ((mean - centre) ** 2 + share * spread).tolist(),  # eq. 3
        }


def _tabulate(settings: NoiseCeilingSettings, rows: Sequence[Row]) -> list[dict[str, Any]]:
    return ceiling_rows(rows, settings.draws)


EXPERIMENT = Experiment(
    name="noise_ceiling",
    question="How much of a touch can be told from cloud and grasp at all, and how much of that do predictors tell?",
    module=__name__,
    settings=NoiseCeilingSettings,
    presets={
        "full": {},
        "smoke": {"samples": 200, "grasps": 20, "repeats": 5, "alone": 10, "effort": 0.1, "draws": 200},
    },
    load=load_simulated,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=ceiling_tables,
    prepare=prepare_simulated,
    free=("predictors", "draws"),
)
