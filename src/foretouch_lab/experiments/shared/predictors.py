# SPDX-License-Identifier: Apache-2.0
"""Predictors that the experiments compare, by name: baselines and the default model.

Each is fitted to labelled grasps and predicts others in one call, as a `Baseline` does. To add one, add a line to
`PREDICTORS`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from foretouch.types import Float64, Sample
from foretouch_lab.learning.evaluation import baselines
from foretouch_lab.learning.evaluation.baselines import Baseline
from foretouch_lab.learning.training.contact import ContactPredictor, ContactTrainingConfig


def _share(training_fraction: float, count: int) -> int:
    return max(1, round(training_fraction * count))


def _trees(baseline: Callable[..., Float64], training_fraction: float) -> Baseline:
    return partial(baseline, trees=_share(training_fraction, baselines.TREES))


def _contact(training_fraction: float) -> Baseline:
    """Return the default model."""
    trees = _share(training_fraction, ContactTrainingConfig().trees)

    def predict(train: Sequence[Sample], labels: Float64, test: Sequence[Sample], seed: int) -> Float64:
        return ContactPredictor(train, labels, ContactTrainingConfig(trees=trees, seed=seed)).predict(test)

    return predict


# By name, from the share of trees: 1 for reported results, less for a smoke test. Deterministic given the seed.
PREDICTORS: Final[dict[str, Callable[[float], Baseline]]] = {
    "training_mean": lambda _: baselines.training_mean,
    "object_mean": lambda _: baselines.object_mean,
    "object_time_trees": partial(_trees, baselines.object_time_trees),
    "clock": lambda _: baselines.clock,
    "geometry_trees": partial(_trees, baselines.geometry_trees),
    "geometry_trees_pose_free": partial(_trees, baselines.geometry_trees_pose_free),
    "contact": _contact,
}
