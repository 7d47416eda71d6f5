# SPDX-License-Identifier: Apache-2.0
"""How much of a touch can be predicted from cloud and grasp at all, and how much of that do predictors reach?

Test grasps are repeated with everything that no camera sees redrawn (`repeats`). With y_r the n repeats of grasp i, m
their mean, s² their variance (n - 1), p a prediction and µ the mean of the training labels, each per value,

    of the best prediction, the mean of all repeats:   S_i = s²                                (1)
    of a predictor:                                    S_i = (p - m)² + s² (1 - 1/n)           (2)
    of the training mean:                              R_i = (µ - m)² + s² (1 - 1/n)           (3)

are unbiased estimates of the squared error on one new execution, for any number of repeats: in eqs. 2 and 3 the
variance of the mean of n repeats is s²/n. Skill is 1 - sum S / sum R as everywhere. Repeats keep the object itself, its
pose and its cloud: more than a model is given, so the ceiling is an upper bound. A predictor's `share` is its skill
over the ceiling's, on the same repeats. With `split: object` there is a second ceiling for objects that were never
touched: their material and day are unknown as well, and predictors are compared with that one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.noise_ceiling.repeats import CAUSES, NEW_OBJECT, Repeater
from foretouch.experiments.noise_ceiling.results import ceiling_rows, ceiling_tables, draw_ceiling_figure
from foretouch.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch.experiments.shared.simulated_data import (
    SimulatedGrasps,
    SimulatedSettings,
    load_simulated,
    prepare_simulated,
)
from foretouch.learning.data import labels_of
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "NoiseCeilingSettings"]

_BLOCK: Final = 10  # grasps per cell


@dataclass(frozen=True, kw_only=True)
class NoiseCeilingSettings(SimulatedSettings):
    """Settings of `noise_ceiling`."""

    grasps: int = setting(200, "Number of test grasps to repeat", minimum=2, maximum=100_000)
    repeats: int = setting(20, "Number of repeats of each grasp", minimum=2, maximum=10_000)
    single_cause_grasps: int = setting(
        60, "Number of these grasps that are also repeated with one cause at a time", minimum=0
    )
    split: str = setting(
        "labels",
        "labels: test on 200 grasps per object; object: test on a fifth of the objects",
        choices=("labels", "object"),
    )
    predictors: tuple[str, ...] = setting(
        ("object_mean", "geometry_trees", "contact"),
        "Predictors to compare with the ceiling",
        choices=tuple(PREDICTORS),
    )
    training_fraction: float = setting(
        1.0, "Fraction of trees and epochs; below 1 only for quick trials", minimum=0.001, maximum=1.0
    )
    draws: int = setting(
        2000, "Number of bootstrap samples of the grasps for the intervals", minimum=100, maximum=1_000_000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.single_cause_grasps > self.grasps:
            count = self.single_cause_grasps
            raise ConfigError(f"NoiseCeilingSettings.single_cause_grasps: {count} exceeds grasps, {self.grasps}")


def _split(settings: NoiseCeilingSettings, data: SimulatedGrasps) -> tuple[list[GraspSample], list[GraspSample]]:
    """Training samples, and the test samples to repeat, which are spread evenly over all test samples."""
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
    whole = ["all", NEW_OBJECT] if settings.split == "object" else ["all"]
    blocks = [(cause, first) for cause in whole for first in range(0, settings.grasps, _BLOCK)]
    blocks += [(cause, first) for cause in CAUSES for first in range(0, settings.single_cause_grasps, _BLOCK)]
    repeated = [
        Cell(f"repeats+{cause}+{first}", {"what": "repeats", "name": cause, "first": first}) for cause, first in blocks
    ]
    predicted = [Cell(f"predictor+{name}", {"what": "predictor", "name": name}) for name in settings.predictors]
    return repeated + predicted


def _run(cell: Cell, settings: NoiseCeilingSettings, data: SimulatedGrasps) -> list[Row]:
    train, test = _split(settings, data)
    labels = labels_of(train)
    if cell.values["what"] == "predictor":
        fitted = find_predictor(cell.values["name"], settings.training_fraction)(train, labels, 0)
        return [
            {"id": sample.id, "predicted": row.tolist()} for sample, row in zip(test, fitted.predict(test), strict=True)
        ]
    cause, first = cell.values["name"], cell.values["first"]
    hidden = {"all": frozenset(CAUSES), NEW_OBJECT: frozenset({*CAUSES, NEW_OBJECT})}.get(cause, frozenset({cause}))
    end = settings.single_cause_grasps if cause in CAUSES else settings.grasps
    grasps = test[first : min(first + _BLOCK, end)]
    return list(_repeated(Repeater(data.scene, hidden), grasps, settings.repeats, labels.mean(axis=0)))


def _repeated(repeater: Repeater, grasps: Sequence[GraspSample], count: int, mean: Float64) -> Iterator[Row]:
    for sample in grasps:
        made = repeater.repeat(int(sample.extra["slot"]), int(sample.extra["attempt"]), count)
        centre, variance = made.touches.mean(axis=0), made.touches.var(axis=0, ddof=1)
        share = 1.0 - 1.0 / len(made.touches)
        yield {
            "id": sample.id,
            "object": sample.object,
            "repeats": len(made.touches),
            "mean": centre.tolist(),
            "rest": (share * variance).tolist(),  # of eqs. 2 and 3
            "within": variance.tolist(),  # eq. 1
            "within_change": (made.touches - made.tares).var(axis=0, ddof=1).tolist(),
            "reference": ((mean - centre) ** 2 + share * variance).tolist(),  # eq. 3
        }


EXPERIMENT = Experiment(
    name="noise_ceiling",
    question="How much of a touch can be predicted from cloud and grasp at all, and how much of that do predictors reach?",
    module=__name__,
    order=50,
    settings=NoiseCeilingSettings,
    presets={
        "full": {},
        "smoke": {
            "samples": 200,
            "grasps": 20,
            "repeats": 5,
            "single_cause_grasps": 10,
            "training_fraction": 0.1,
            "draws": 200,
        },
    },
    load=load_simulated,
    cells=_cells,
    run=_run,
    tabulate=lambda settings, rows: ceiling_rows(rows, settings.draws),
    summarise=ceiling_tables,
    figure=draw_ceiling_figure,
    prepare=prepare_simulated,
    resumable_settings=("predictors", "draws"),
)
