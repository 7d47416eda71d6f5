# SPDX-License-Identifier: Apache-2.0
"""Predictors that the experiments compare, by name: baselines, recipes of `foretouch train` and the default model.

Each is fitted to labelled grasps and predicts others in one call, as a `Baseline` does. To add one, add a line to
`PREDICTORS`. A recipe with one modality is trained once for each modality.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.models.novelty import Fallback
from foretouch.tactile import BIOTAC, MODALITIES, TOUCH_SIZE
from foretouch.types import Float64, Sample
from foretouch_lab.learning.data.training_set import TrainingSet, predict_set
from foretouch_lab.learning.evaluation import baselines
from foretouch_lab.learning.evaluation.baselines import Baseline
from foretouch_lab.learning.training.contact import ContactPredictor, describe_objects

# The networks by name, with the recipe of `foretouch train` that each is trained by.
RECIPES: Final = {"p1_pointnet": "p1", "p2_pointnet": "p2", "touchnet_v1": "touchnet-v1"}


def network(name: str, training_fraction: float, changes: Mapping[str, Any] | None = None) -> Baseline:
    """Return a recipe as a baseline, which is trained again in each call.

    Args:
        name: One of `RECIPES`.
        training_fraction: Share of its epochs; at least one is run.
        changes: Settings of the recipe that differ, by dotted name.
    """

    def _predict(train: Sequence[Sample], labels: Float64, test: Sequence[Sample], seed: int) -> Float64:
        from foretouch_lab.learning.training.run_config import load_run_config
        from foretouch_lab.learning.training.supervised import train_network

        recipe: Any = load_run_config(RECIPES[name]).updated(changes or {})  # of a supervised network
        model, how = recipe.model, recipe.train
        how = how.replace(epochs=_share(training_fraction, how.epochs), seed=seed)
        data = TrainingSet.build([*train, *test], model, unlabelled=True)
        data = replace(data, labels=np.concatenate([labels, np.full((len(test), TOUCH_SIZE), np.nan)]))
        train_index, test_index = np.arange(len(train)), np.arange(len(train), len(data))
        predicted = np.empty((len(test), TOUCH_SIZE))
        together = model.outputs == MODALITIES
        for outputs in [MODALITIES] if together else [(modality,) for modality in MODALITIES]:
            part = replace(data, config=model.replace(outputs=outputs))
            predicted[:, BIOTAC.columns(outputs)] = predict_set(train_network(part, train_index, how), part, test_index)
        if not together:
            return predicted
        # Faded to the mean on objects out of the training distribution, as the released network does.
        return Fallback.fit(BIOTAC, describe_objects(train), labels).fade(predicted, describe_objects(test))[0]

    return _predict


def _share(training_fraction: float, count: int) -> int:
    return max(1, round(training_fraction * count))


def _trees(baseline: Callable[..., Float64], training_fraction: float) -> Baseline:
    return partial(baseline, trees=_share(training_fraction, baselines.TREES))


def contact_predictor(
    training_fraction: float, train: Sequence[Sample], labels: Float64, seed: int
) -> ContactPredictor:
    """Return the default model, which has its own adaptation to touches, with a share of its trees.

    Args:
        training_fraction: Share of its trees.
        train: Samples to fit to.
        labels: (S, D) their labels [counts].
        seed: Of the trees.
    """
    from foretouch_lab.learning.training.run_config import load_run_config

    config: Any = load_run_config("contact-v3").contact
    return ContactPredictor(train, labels, config.replace(trees=_share(training_fraction, config.trees), seed=seed))


def _contact(training_fraction: float) -> Baseline:
    return lambda train, labels, test, seed: contact_predictor(training_fraction, train, labels, seed).predict(test)


# By name, from the share of trees or epochs: 1 for reported results, less for a smoke test. Deterministic given the seed.
PREDICTORS: Final[dict[str, Callable[[float], Baseline]]] = {
    "training_mean": lambda _: baselines.training_mean,
    "object_mean": lambda _: baselines.object_mean,
    "object_time_trees": partial(_trees, baselines.object_time_trees),
    "geometry_trees": partial(_trees, baselines.geometry_trees),
    "geometry_trees_pose_free": partial(_trees, baselines.geometry_trees_pose_free),
    "clock": lambda _: baselines.clock,
    "contact": _contact,
    **{name: partial(network, name) for name in RECIPES},
}

NETWORKS: Final = tuple(RECIPES)  # predictors that take minutes to hours per fold
