# SPDX-License-Identifier: Apache-2.0
"""The published networks as predictors: `config/train/p1.yaml`, `p2.yaml` and `touchnet-v1.yaml`, a test holds them equal.

They stand here as well because an installed package has no `config/`.

All predictors that the experiments on real grasps compare, by name.

A predictor is fitted to labelled grasps and then asked, with or without touches of the object at hand. A `Baseline`
knows nothing of such touches: `shrunk_residuals` lends it the simplest use of them. A new predictor is a line in
`PREDICTORS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, Protocol

import numpy as np

from foretouch.errors import ConfigError
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.baselines import (
    TREES,
    Baseline,
    geometry_trees,
    object_mean,
    object_time_trees,
    training_mean,
)
from foretouch.learning.training.contact import ContactConfig
from foretouch.learning.training.contact_predictor import ContactPredictor
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64, GraspSample

__all__ = [
    "NETWORKS",
    "PREDICTORS",
    "RECIPES",
    "SHRINKAGE",
    "Fit",
    "Fitted",
    "find_predictor",
    "network",
    "shrunk_residuals",
]


_PAPERS: Final = {"weight_decay": 0.0, "schedule": "constant", "loss": "rmse", "target_scaling": "ranges"}

RECIPES: Final[dict[str, dict[str, Any]]] = {
    "p1_pointnet": {
        "model": {
            "n_points": 500,
            "use_grasp": False,
            "head_widths": [512, 256],
            "head_norm": True,
            "ranges": {"pdc_th": [0, 3100], "pdc_mf": [0, 2000], "e_th": [0, 3500], "e_mf": [0, 3800]},
        },
        "train": {"epochs": 50, "batch_size": 5, "optimiser": "sgd", "learning_rate": 0.01, **_PAPERS},
        "one_a_modality": True,
    },
    "p2_pointnet": {
        "model": {"channels": "xyz+normals"},
        "train": {"epochs": 50, "batch_size": 32, "optimiser": "adam", "learning_rate": 0.01, **_PAPERS},
        "one_a_modality": True,
    },
    "touchnet_v1": {
        "model": {
            "tnet": False,
            "trunk_widths": [32, 64, 128],
            "head_widths": [128],
            "head_dropout": 0.3,
            "metric_inputs": True,
        },
        "train": {"epochs": 120, "turn_deg": 20.0, "points": 256},
        "one_a_modality": False,
        "falls_back": True,
    },
}


def network(name: str, effort: float) -> Baseline:
    """A recipe as a baseline, which is trained anew for each call.

    Args:
        name: Out of `RECIPES`.
        effort: Share of its epochs, at least one is run.

    Raises:
        ConfigError: If there is no such recipe.
    """
    if name not in RECIPES:
        raise ConfigError(f"recipe: {name!r} is none of {', '.join(RECIPES)}")
    recipe = RECIPES[name]
    groups = [(one,) for one in MODALITIES] if recipe["one_a_modality"] else [MODALITIES]

    def predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        from foretouch.learning.data.training_set import TrainingSet
        from foretouch.learning.training.supervised import TrainConfig, predict_set, train_network
        from foretouch.models.network.config import ModelConfig

        model = ModelConfig.from_mapping(recipe["model"], name)
        how = TrainConfig.from_mapping(recipe["train"], name)
        how = how.replace(epochs=max(1, round(effort * how.epochs)), seed=seed)
        data = TrainingSet.build([*train, *test], model, unlabelled=True)
        hidden = np.full((len(test), TOUCH_SIZE), np.nan)
        data = replace(data, labels=np.concatenate([labels, hidden]))
        learned, asked = np.arange(len(train)), np.arange(len(train), len(data))
        predicted = np.empty((len(test), TOUCH_SIZE))
        for outputs in groups:
            part = replace(data, config=model.replace(outputs=outputs))
            predicted[:, columns(outputs)] = predict_set(train_network(part, learned, how), part, asked)
        return _fallen_back(predicted, train, labels, test) if recipe.get("falls_back") else predicted

    return predict


def _fallen_back(
    predicted: Float64, train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample]
) -> Float64:
    """As the shipped network's predictions fade on objects unlike those of training."""
    from foretouch.learning.training.contact import describe_objects
    from foretouch.models.novelty import Fallback

    return Fallback.fit(describe_objects(train), labels).fade(predicted, describe_objects(test))[0]


SHRINKAGE: Final = 2.0
"""a of the shrunk mean of the residuals, in touches."""


class Fitted(Protocol):
    """A predictor that was fitted to some grasps."""

    def predict(self, samples: Sequence[GraspSample]) -> Float64:
        """(S, 50) predictions [counts]; labels of the samples, if they have any, are not looked at."""
        ...

    def predict_after(self, touched: Sequence[GraspSample], samples: Sequence[GraspSample]) -> Float64:
        """The same after the touches of `touched`, which are of the same object and not among the samples."""
        ...


class Fit(Protocol):
    """Fits a predictor: training samples, their (S, 50) labels [counts], seed."""

    def __call__(self, train: Sequence[GraspSample], labels: Float64, seed: int, /) -> Fitted:
        """What was fitted; the same arguments give the same predictions."""
        ...


class _Shrunk:
    """A baseline, and after touches the shrunk mean of its residuals.

    After n touches with residuals r_i = label - prediction it adds n / (n + a) · mean r_i: the posterior mean
    of an offset of the object, where a is the variance of a single residual over that of the offsets.
    """

    def __init__(self, baseline: Baseline, train: Sequence[GraspSample], labels: Float64, seed: int) -> None:
        self._ask = partial(baseline, train, labels)
        self._seed = seed
        self._known: dict[str, Float64] = {}  # a baseline is fitted anew for each question

    def predict(self, samples: Sequence[GraspSample]) -> Float64:
        new = [sample for sample in samples if sample.id not in self._known]
        if new:
            self._known |= {s.id: row for s, row in zip(new, self._ask(new, self._seed), strict=True)}
        return np.array([self._known[sample.id] for sample in samples])

    def predict_after(self, touched: Sequence[GraspSample], samples: Sequence[GraspSample]) -> Float64:
        if not touched:
            return self.predict(samples)
        residuals = labels_of(touched) - self.predict(touched)
        weight = len(touched) / (len(touched) + SHRINKAGE)
        return np.asarray(self.predict(samples) + weight * residuals.mean(axis=0), np.float64)


def shrunk_residuals(baseline: Baseline) -> Fit:
    """A baseline as a predictor; touches move it by the shrunk mean of their residuals (a = `SHRINKAGE`)."""
    return partial(_Shrunk, baseline)


def _trees(baseline: Callable[..., Float64], effort: float) -> Fit:
    return shrunk_residuals(partial(baseline, trees=max(1, round(effort * TREES))))


def _contact(effort: float) -> Fit:
    """Our own model, which makes its own use of touches."""
    config = ContactConfig()
    config = config.replace(trees=max(1, round(effort * config.trees)))
    return lambda train, labels, seed: ContactPredictor(train, labels, config.replace(seed=seed))


PREDICTORS: Final[dict[str, Callable[[float], Fit]]] = {
    "training_mean": lambda _: shrunk_residuals(training_mean),
    "object_mean": lambda _: shrunk_residuals(object_mean),
    "object_time_trees": lambda effort: _trees(object_time_trees, effort),
    "geometry_trees": lambda effort: _trees(geometry_trees, effort),
    "contact": _contact,
    "p1_pointnet": lambda effort: shrunk_residuals(network("p1_pointnet", effort)),
    "p2_pointnet": lambda effort: shrunk_residuals(network("p2_pointnet", effort)),
    "touchnet_v1": lambda effort: shrunk_residuals(network("touchnet_v1", effort)),
}
"""By name, given the share of trees or epochs that it may spend: 1 for what is reported, less for a smoke test."""

NETWORKS: Final = ("p1_pointnet", "p2_pointnet", "touchnet_v1")
"""Those that take minutes to hours a fold."""


def find_predictor(name: str, effort: float = 1.0) -> Fit:
    """A predictor by name.

    Raises:
        ConfigError: If there is none.
    """
    if name not in PREDICTORS:
        raise ConfigError(f"predictors: {name!r} is none of {', '.join(PREDICTORS)}")
    return PREDICTORS[name](effort)
