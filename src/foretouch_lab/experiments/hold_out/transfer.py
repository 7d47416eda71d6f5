# SPDX-License-Identifier: Apache-2.0
"""Predictors of `sim_to_real`, which use trees that were trained on simulated grasps.

The trees learn the change from the tare, since simulated resting readings are not those of a real finger. For a real
grasp x they predict f(x). With µ the mean of the real labels of the training objects and f̄ that of f over their
grasps:

    offset     µ + f(x) - f̄                                                                   (1)
    scaled     µ + b (f(x) - f̄),  b of each modality by least squares on the training grasps   (2)
    residual   scaled, and trees trained on its real residuals                                 (3)

b is limited to 0...1, so that simulation is at most used in full and never inverted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from foretouch.tactile import BIOTAC, MODALITIES, offsets
from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.shared.predictors import Fit, Fitted, with_offset_correction
from foretouch_lab.experiments.shared.scores import labelled
from foretouch_lab.experiments.shared.simulated_data import RealAndSimulated
from foretouch_lab.learning.evaluation.baselines import TREES, Baseline, geometry_trees

Changes = Mapping[str, Float64]  # f by the id of the sample


def _offset(changes: Changes, _trees: int) -> Baseline:
    """Eq. 1."""
    return partial(_transfer, changes, lambda f, _: np.ones(f.shape[1]))


def _scaled(changes: Changes, _trees: int) -> Baseline:
    """Eq. 2."""
    return partial(_transfer, changes, _slopes)


def _residual(changes: Changes, trees: int) -> Baseline:
    """Eq. 3."""

    def _predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        predicted = _scaled(changes, trees)(train, labels, [*train, *test], seed)
        residuals = labels - predicted[: len(train)]
        return predicted[len(train) :] + geometry_trees(train, residuals, test, seed, trees=trees)

    return _predict


# By name of the predictor, from f and the number of real trees.
TRANSFER_METHODS: Final[dict[str, Callable[[Changes, int], Baseline]]] = {
    "simulated_offset": _offset,
    "simulated_scaled": _scaled,
    "simulated_and_real": _residual,
}


def _transfer(
    changes: Changes,
    slopes: Callable[[Float64, Float64], Float64],
    train: Sequence[GraspSample],
    labels: Float64,
    test: Sequence[GraspSample],
    _seed: int,
) -> Float64:
    f, f_test = (np.array([changes[sample.id] for sample in side]) for side in (train, test))
    return np.asarray(labels.mean(axis=0) + slopes(f, labels) * (f_test - f.mean(axis=0)), np.float64)


def _slopes(f: Float64, labels: Float64) -> Float64:
    """(50,) b of eq. 2: one for all values of a modality."""
    f, labels = f - f.mean(axis=0), labels - labels.mean(axis=0)
    result = np.zeros(f.shape[1])
    for name in MODALITIES:
        index = BIOTAC.columns([name])
        squares = float((f[:, index] ** 2).sum())
        if squares > 0.0:
            result[index] = np.clip(float((f[:, index] * labels[:, index]).sum()) / squares, 0.0, 1.0)
    return result


def fit_transfer(name: str, data: RealAndSimulated, training_fraction: float) -> Fit:
    """The fit of one of `TRANSFER_METHODS`."""
    trees = max(1, round(training_fraction * TREES))

    def _fit(train: Sequence[GraspSample], labels: Float64, seed: int) -> Fitted:
        method: Any = TRANSFER_METHODS[name](_changes(data, seed, trees), trees)
        return with_offset_correction(method)(train, labels, seed)

    return _fit


@lru_cache(maxsize=1)
def _changes(data: RealAndSimulated, seed: int, trees: int) -> Changes:
    """Predict f for every real grasp: (50,) by id [counts]; labels of the real grasps are not used."""
    real = labelled(data.real)
    pairs = [(one, offsets(one.touch, one.tare)) for one in labelled(data.simulated) if one.touch and one.tare]
    train, changes = zip(*pairs, strict=True)
    blind = [replace(sample, touch=None) for sample in real]
    predicted = geometry_trees(train, np.array(changes), blind, seed, trees=trees)
    return {sample.id: row for sample, row in zip(real, predicted, strict=True)}
