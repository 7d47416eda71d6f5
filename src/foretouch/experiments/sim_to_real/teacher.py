# SPDX-License-Identifier: Apache-2.0
"""What trees that never felt anything real say of real grasps, and four ways to lean on it.

The trees learn from simulated grasps the change from the tare, since no simulated rest is that of a real finger. Of a real
grasp x they say f(x). With µ the mean of the real labels of the training objects and f̄ that of f over their grasps:

    offset     µ + f(x) - f̄                                                                   (1)
    scaled     µ + b (f(x) - f̄),  b of each modality by least squares on the training grasps   (2)
    residual   scaled, and real trees on what it leaves                                        (3)

b is held to 0...1: what was simulated counts at most in full, and not at all rather than upside down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from foretouch.learning.evaluation.baselines import Baseline, geometry_trees
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import Float64, GraspSample

__all__ = ["LEANINGS", "simulated_changes"]

Said = Mapping[str, Float64]
"""f by the id of the sample."""


def simulated_changes(
    simulated: Sequence[GraspSample], real: Sequence[GraspSample], seed: int, trees: int
) -> dict[str, Float64]:
    """F of every real grasp: (50,) by id [counts].

    Args:
        simulated: Samples with touch and tare.
        real: Samples whose labels are not looked at.
        seed: Of the trees.
        trees: How many.
    """
    taught = [sample for sample in simulated if sample.touch is not None and sample.tare is not None]
    changes = np.array(
        [s.touch.vector() - s.tare.vector() for s in taught if s.touch is not None and s.tare is not None]
    )
    predicted = geometry_trees(taught, changes, [replace(sample, touch=None) for sample in real], seed, trees=trees)
    return {sample.id: row for sample, row in zip(real, predicted, strict=True)}


def offset(said: Said) -> Baseline:
    """Eq. 1."""
    return _lean(said, lambda f, _labels: np.ones(f.shape[1]))


def scaled(said: Said) -> Baseline:
    """Eq. 2."""
    return _lean(said, _slopes)


def residual(said: Said, trees: int) -> Baseline:
    """Eq. 3."""

    def predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        everyone = scaled(said)(train, labels, [*train, *test], seed)
        left = labels - everyone[: len(train)]
        return everyone[len(train) :] + geometry_trees(train, left, test, seed, trees=trees)

    return predict


LEANINGS: Final[dict[str, Callable[[Said, int], Baseline]]] = {
    "simulated_offset": lambda said, _: offset(said),
    "simulated_scaled": lambda said, _: scaled(said),
    "simulated_and_real": residual,
}
"""By name, given f and the number of real trees."""


def _lean(said: Said, slopes: Callable[[Float64, Float64], Float64]) -> Baseline:
    def predict(train: Sequence[GraspSample], labels: Float64, test: Sequence[GraspSample], seed: int) -> Float64:
        del seed
        f, asked = (np.array([said[sample.id] for sample in side]) for side in (train, test))
        return np.asarray(labels.mean(axis=0) + slopes(f, labels) * (asked - f.mean(axis=0)), np.float64)

    return predict


def _slopes(f: Float64, labels: Float64) -> Float64:
    """(50,) b of eq. 2: one for all values of a modality."""
    moved, felt = f - f.mean(axis=0), labels - labels.mean(axis=0)
    result = np.zeros(f.shape[1])
    for name in MODALITIES:
        place = columns([name])
        size = float((moved[:, place] ** 2).sum())
        result[place] = np.clip(float((moved[:, place] * felt[:, place]).sum()) / size, 0.0, 1.0) if size > 0.0 else 0.0
    return result
