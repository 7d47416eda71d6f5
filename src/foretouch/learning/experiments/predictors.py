# SPDX-License-Identifier: Apache-2.0
"""All predictors that the experiments on real grasps compare, by name.

A predictor is fitted to labelled grasps and then asked, with or without touches of the object at hand. A `Baseline`
knows nothing of such touches: `shrunk_residuals` lends it the simplest use of them. A new predictor is a line in
`PREDICTORS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Protocol

import numpy as np

from foretouch.errors import ConfigError
from foretouch.learning.baselines import (
    TREES,
    Baseline,
    geometry_trees,
    object_mean,
    object_time_trees,
    training_mean,
)
from foretouch.learning.contact_predictor import ContactPredictor
from foretouch.learning.contact_training import ContactConfig
from foretouch.learning.experiments.recipes import network
from foretouch.learning.training_set import labels_of
from foretouch.types import Float64, GraspSample

__all__ = ["NETWORKS", "PREDICTORS", "SHRINKAGE", "Fit", "Fitted", "find_predictor", "shrunk_residuals"]

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
