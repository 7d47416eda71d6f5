# SPDX-License-Identifier: Apache-2.0
"""Errors of predictions by modality, in counts and as skill against the mean of the training labels.

An error in counts means little by itself: P1's published errors are larger than those of the mean of the
training labels on the same data. `skill` compares with that mean: 0 equals it, 1 is perfect.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from foretouch.errors import DatasetError
from foretouch.tactile import MODALITIES, P2_RANGES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Float64

__all__ = ["Score", "mean_skill", "score"]


@dataclass(frozen=True)
class Score:
    """Errors of one modality.

    Attributes:
        rmse: Root of the mean squared error over all samples and electrodes [counts].
        nrmse: `rmse` over the width of the modality's range, as published in the papers.
        skill: 1 - MSE / MSE of the training mean, per value, averaged over the modality's values.
    """

    rmse: float
    nrmse: float
    skill: float


def score(
    predicted: Float64,
    actual: Float64,
    reference: Float64,
    ranges: TactileRanges = P2_RANGES,
    modalities: Sequence[str] = MODALITIES,
) -> dict[str, Score]:
    """Score predictions.

    Args:
        predicted: (S, 50) [counts].
        actual: (S, 50) labels [counts].
        reference: (S, 50) mean of the training labels of each sample's model [counts].
        ranges: Ranges for `nrmse`.
        modalities: Modalities to score; the other columns must be finite, too.

    Raises:
        DatasetError: If a shape is wrong, there is no sample, a value is not finite, or the training
            mean is exact, which leaves the skill undefined.
    """
    _check(predicted, actual, reference)
    squared = (predicted - actual) ** 2
    baseline = ((reference - actual) ** 2).mean(axis=0)
    result = {}
    for name in modalities:
        column = columns([name])
        if not np.all(baseline[column] > 0.0):
            raise DatasetError(f"{name}: the training mean is exact, so the skill is undefined")
        low, high = ranges.of(name)
        rmse = float(np.sqrt(squared[:, column].mean()))
        skill = float(np.mean(1.0 - squared[:, column].mean(axis=0) / baseline[column]))
        result[name] = Score(rmse, rmse / (high - low), skill)
    return result


def mean_skill(scores: dict[str, Score]) -> float:
    """Skill averaged over the modalities: the number by which models are selected."""
    return float(np.mean([one.skill for one in scores.values()]))


def _check(predicted: Float64, actual: Float64, reference: Float64) -> None:
    for name, values in (("predicted", predicted), ("actual", actual), ("reference", reference)):
        if values.ndim != 2 or values.shape != (len(actual), TOUCH_SIZE) or len(values) == 0:
            raise DatasetError(f"{name}: shape {values.shape} is not (S, {TOUCH_SIZE}) with S of at least 1")
        if not np.isfinite(values).all():
            raise DatasetError(f"{name}: holds a value that is not finite")
