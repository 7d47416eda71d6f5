# SPDX-License-Identifier: Apache-2.0
"""Predictors that the experiments compare, by name.

A predictor is fitted to labelled grasps and then predicts others, without or after touches of the same object. A
`Baseline` does not use such touches: `with_offset_correction` adds the simplest use of them. To add a predictor, add a
line to `PREDICTORS`.

The networks are those of the recipes of `foretouch train`; a recipe with one modality is trained once for each
modality.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, TypeAlias

import numpy as np

from foretouch.errors import ConfigError
from foretouch.models.novelty import Fallback
from foretouch.tactile import BIOTAC, MODALITIES, TOUCH_SIZE
from foretouch.types import Float64, GraspSample
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.data.training_set import TrainingSet, predict_set
from foretouch_lab.learning.evaluation import baselines
from foretouch_lab.learning.training.contact import ContactPredictor, ContactTrainingConfig, describe_objects

# The networks by name, with the recipe of `foretouch train` that each is trained by.
RECIPES: Final = {"p1_pointnet": "p1", "p2_pointnet": "p2", "touchnet_v1": "touchnet-v1"}


def network(name: str, training_fraction: float, changes: Mapping[str, Any] | None = None) -> baselines.Baseline:
    """A recipe as a baseline, which is trained again in each call.

    Args:
        name: One of `RECIPES`.
        training_fraction: Share of its epochs; at least one is run.
        changes: Settings of the recipe that differ, by dotted name.

    Raises:
        ConfigError: If there is no such recipe.
    """
    if name not in RECIPES:
        raise ConfigError(f"recipe: {name!r} is not one of {', '.join(RECIPES)}")

    def _predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        from foretouch_lab.learning.training.run_config import load_run_config
        from foretouch_lab.learning.training.supervised import train_network

        recipe: Any = load_run_config(RECIPES[name]).updated(changes or {})  # of a supervised network
        model, how = recipe.model, recipe.train
        how = how.replace(epochs=max(1, round(training_fraction * how.epochs)), seed=seed)
        data = TrainingSet.build([*train, *test], model, unlabelled=True)
        data = replace(data, labels=np.concatenate([labels, np.full((len(test), TOUCH_SIZE), np.nan)]))
        train_index, test_index = np.arange(len(train)), np.arange(len(train), len(data))
        predicted = np.empty((len(test), TOUCH_SIZE))
        together = model.outputs == MODALITIES
        for outputs in [MODALITIES] if together else [(one,) for one in MODALITIES]:
            part = replace(data, config=model.replace(outputs=outputs))
            predicted[:, BIOTAC.columns(outputs)] = predict_set(train_network(part, train_index, how), part, test_index)
        if not together:
            return predicted
        # Faded to the mean on objects out of the training distribution, as the released network does.
        return Fallback.fit(BIOTAC, describe_objects(train), labels).fade(predicted, describe_objects(test))[0]

    return _predict


SHRINKAGE: Final = 2.0  # a of the offset correction, in touches


Fit: TypeAlias = Callable[[Sequence[GraspSample], Float64, int], "ContactPredictor | _OffsetCorrected"]
"""Fits a predictor to training samples and their (S, 50) labels [counts]; deterministic given the seed."""


class _OffsetCorrected:
    """A baseline with an offset of the object that is estimated from touches.

    After n touches with residuals r_i = label - prediction it adds n / (n + a) · mean r_i: the posterior mean of the
    object's offset, where a is the variance of a single residual over that of the offsets.
    """

    def __init__(self, baseline: baselines.Baseline, train: Sequence[GraspSample], labels: Float64, seed: int) -> None:
        self._baseline = partial(baseline, train, labels)
        self._seed = seed
        self._cache: dict[str, Float64] = {}  # by id: a baseline is fitted in each call

    def predict(self, samples: Sequence[GraspSample]) -> Float64:
        """(S, 50) predictions [counts]; labels of the samples are not used."""
        new = [sample for sample in samples if sample.id not in self._cache]
        if new:
            self._cache |= {s.id: row for s, row in zip(new, self._baseline(new, self._seed), strict=True)}
        return np.array([self._cache[sample.id] for sample in samples])

    def predict_after(self, touched: Sequence[GraspSample], samples: Sequence[GraspSample]) -> Float64:
        """(S, 50) predictions [counts] after touches of the same object that are not among the samples."""
        if not touched:
            return self.predict(samples)
        residuals = labels_of(touched) - self.predict(touched)
        weight = len(touched) / (len(touched) + SHRINKAGE)
        return np.asarray(self.predict(samples) + weight * residuals.mean(axis=0), np.float64)


def with_offset_correction(baseline: baselines.Baseline) -> Fit:
    """A baseline as a predictor that adds the shrunken mean of the touches' residuals (a = `SHRINKAGE`)."""
    return partial(_OffsetCorrected, baseline)


def _trees(baseline: Callable[..., Float64], training_fraction: float) -> Fit:
    return with_offset_correction(partial(baseline, trees=max(1, round(training_fraction * baselines.TREES))))


def _contact(training_fraction: float) -> Fit:
    """The default model, which has its own adaptation to touches."""
    from foretouch_lab.learning.training.run_config import load_run_config

    run: Any = load_run_config("contact-v2")
    config: ContactTrainingConfig = run.contact
    config = config.replace(trees=max(1, round(training_fraction * config.trees)))
    return lambda train, labels, seed: ContactPredictor(train, labels, config.replace(seed=seed))


# By name, from the share of trees or epochs: 1 for reported results, less for a smoke test.
PREDICTORS: Final[dict[str, Callable[[float], Fit]]] = {
    "training_mean": lambda _: with_offset_correction(baselines.training_mean),
    "object_mean": lambda _: with_offset_correction(baselines.object_mean),
    "object_time_trees": lambda training_fraction: _trees(baselines.object_time_trees, training_fraction),
    "geometry_trees": lambda training_fraction: _trees(baselines.geometry_trees, training_fraction),
    "clock": lambda _: with_offset_correction(baselines.clock),
    "contact": _contact,
    "p1_pointnet": lambda training_fraction: with_offset_correction(network("p1_pointnet", training_fraction)),
    "p2_pointnet": lambda training_fraction: with_offset_correction(network("p2_pointnet", training_fraction)),
    "touchnet_v1": lambda training_fraction: with_offset_correction(network("touchnet_v1", training_fraction)),
}

NETWORKS: Final = tuple(RECIPES)  # predictors that take minutes to hours per fold


def find_predictor(name: str, training_fraction: float = 1.0) -> Fit:
    """Find a predictor by name; a `ConfigError` if there is none."""
    if name not in PREDICTORS:
        raise ConfigError(f"predictors: {name!r} is not one of {', '.join(PREDICTORS)}")
    return PREDICTORS[name](training_fraction)
