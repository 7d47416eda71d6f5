# SPDX-License-Identifier: Apache-2.0
"""How good predictions are, per modality, and against a model that knows nothing.

An error in counts says little alone: P1's published errors are larger than those of the mean of the
training labels on the same data. `skill` compares with that mean and is 0 for it, 1 for a perfect model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from foretouch.errors import DatasetError
from foretouch.tactile import MODALITIES, P2_RANGES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Float64

__all__ = ["Score", "mean_skill", "score"]


@dataclass(frozen=True)
class Score:
    """Of one modality.

    Attributes:
        rmse: Root of the mean squared error over all samples and electrodes [counts].
        nrmse: The same over the width of the modality's range: what the papers print.
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
        reference: (S, 50) mean of the labels that each sample's model was trained on [counts].
        ranges: For `nrmse`.
        modalities: Those to score; the columns of the others are not told of.

    Raises:
        DatasetError: If a shape is another, there is no sample, a value is not finite, or the training
            mean is exact, which leaves the skill open.
    """
    _check(predicted, actual, reference)
    squared = (predicted - actual) ** 2
    baseline = ((reference - actual) ** 2).mean(axis=0)
    result = {}
    for name in modalities:
        place = columns([name])
        if not np.all(baseline[place] > 0.0):
            raise DatasetError(f"{name}: the training mean is exact, so no skill can be told")
        low, high = ranges.of(name)
        rmse = float(np.sqrt(squared[:, place].mean()))
        skill = float(np.mean(1.0 - squared[:, place].mean(axis=0) / baseline[place]))
        result[name] = Score(rmse, rmse / (high - low), skill)
    return result


def mean_skill(scores: dict[str, Score]) -> float:
    """Skill averaged over the four modalities: the one number that models are chosen by."""
    return float(np.mean([one.skill for one in scores.values()]))


def _check(predicted: Float64, actual: Float64, reference: Float64) -> None:
    for name, values in (("predicted", predicted), ("actual", actual), ("reference", reference)):
        if values.ndim != 2 or values.shape != (len(actual), TOUCH_SIZE) or len(values) == 0:
            raise DatasetError(f"{name}: shape {values.shape} is not (S, {TOUCH_SIZE}) with S of at least 1")
        if not np.isfinite(values).all():
            raise DatasetError(f"{name}: holds a value that is not finite")
