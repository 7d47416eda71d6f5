# SPDX-License-Identifier: Apache-2.0
"""Errors and skill of predictions by modality, with confidence intervals and comparisons by bootstrap over objects.

An error in counts means little by itself: P1's published errors are larger than the errors of the mean of the
training labels on the same data. `skill` compares with that mean: 0 equals it, 1 is perfect.

Grasps of one object are correlated (one shape, one session), so objects are resampled, not grasps: a cluster
bootstrap (Davison & Hinkley 1997, section 3.8). With O objects, a draw takes O of them with replacement, and with

    S_o = sum over the grasps of object o of (prediction - label)², per value of the modality
    R_o = the same for the mean of the labels that the predictor of that grasp was trained on

the skill of a draw with object o taken w_o times is (pooled over folds and seeds)

    skill = mean over the modality's values of 1 - sum_o w_o S_o / sum_o w_o R_o .          (1)

Two predictors are compared by the difference of their skills in the *same* draws, so that an object which is difficult
for both favours neither.

With few objects, percentiles of a bootstrap are too narrow. With 8, plain 95 % percentiles contain the true value in 89
% of cases (for a mean of normals: half width 1.96 √(7/8) of a standard error where Student's t requires 2.365).
So the percentiles are expanded (Hesterberg 2015, "What Teachers Should Know About the Bootstrap", The
American Statistician 69, section 4): the tail is

    Φ(-√(O / (O - 1)) t_{O-1, 1-α/2})                                                        (2)

instead of α/2, 0.6 % instead of 2.5 % for 8 objects. No draw leaves the range that the objects span, which
contains the median of a population with probability 1 - 2^(1-O) only: below 6 objects that is under 95 %, and no
interval is given. In every case the interval is valid for objects *like these*: 8 household objects, each recorded on
different days, guarantee nothing about another hand, camera or kind of object.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import DatasetError
from foretouch.tactile import Ranges
from foretouch.types import Bool, Float64
from foretouch.types.channels import Channels

Score = dict[str, float]
"""Errors of one modality:

    rmse   root of the mean squared error over all samples and electrodes [counts]
    nrmse  `rmse` over the width of the modality's range, as published in the papers
    skill  1 - MSE / MSE of the training mean, per value, averaged over the modality's values
"""


def score(
    predicted: Float64,
    actual: Float64,
    reference: Float64,
    ranges: Ranges,
    modalities: Sequence[str] | None = None,
    valid: Bool | None = None,
) -> dict[str, Score]:
    """Score predictions.

    Args:
        predicted: (S, D) [counts].
        actual: (S, D) labels [counts].
        reference: (S, D) mean of the training labels of each sample's model [counts].
        ranges: Ranges for `nrmse`, and the channels.
        modalities: Modalities to score, by default all; the other columns must be finite, too.
        valid: (D,) values to score, such as all values of working taxels; by default all.

    Raises:
        DatasetError: If there is no sample, a value is not finite, or the training mean is exact, which leaves the skill
            undefined.
    """
    channels = ranges.channels
    if not len(actual) or not np.isfinite([predicted, actual, reference]).all():
        raise DatasetError("scores: there is no sample, or a value is not finite")
    squared = (predicted - actual) ** 2
    baseline = ((reference - actual) ** 2).mean(axis=0)
    result = {}
    for name in modalities or channels.modalities:
        column = channels.columns([name])
        column = column if valid is None else column[valid[column]]
        scored = column[(baseline[column] > 0.0) | channels.tared[column]]  # without taxels that never read a force
        if not len(scored) or not np.all(baseline[scored] > 0.0):
            raise DatasetError(f"{name}: the training mean is exact, so the skill is undefined")
        low, high = ranges.of(name)
        rmse = float(np.sqrt(squared[:, column].mean()))
        skill = float(np.mean(1.0 - squared[:, scored].mean(axis=0) / baseline[scored]))
        result[name] = {"rmse": rmse, "nrmse": rmse / (high - low), "skill": skill}
    return result


def mean_skill(scores: Mapping[str, Mapping[str, float]]) -> float:
    """Return the skill averaged over the modalities: the number by which models are selected."""
    return float(np.mean([score["skill"] for score in scores.values()]))


LEAST_OBJECTS: Final = 6
"""Fewest objects for an interval: 2^(1 - 6) is below 5 %."""

_MISS: Final = 0.05  # of the nominal intervals

MEAN: Final = "mean"
"""Key of the mean of the skills, beside the modalities."""

Verdict = Literal["better", "worse", "tie", "too few objects"]


@dataclass(frozen=True, kw_only=True)
class BootstrapConfig(Settings):
    """Settings of the bootstrap."""

    draws: int = setting(10_000, "Resamples of the objects", bounds=(100, 1_000_000))


_DEFAULT: Final = BootstrapConfig()


@dataclass(frozen=True, eq=False)
class ObjectErrors:
    """Squared errors of one predictor, summed over the test grasps of each object."""

    objects: tuple[str, ...]  # (O,) names, sorted
    counts: Float64  # (O,) float64, test grasps
    squared: Float64  # (O, D) float64, S of eq. 1 [counts²]
    reference: Float64  # (O, D) float64, R of eq. 1 [counts²]
    channels: Channels  # of the readings

    @classmethod
    def of_rows(cls, rows: Sequence[Mapping[str, Any]], channels: Channels) -> Self:
        """Sum rows of an `object`, its `count`, `squared` and `reference`, in any order and with objects repeated."""
        names = tuple(sorted({row["object"] for row in rows}))
        if not names:
            raise DatasetError("comparison: no object")
        counts = np.zeros(len(names))
        squared, reference = np.zeros((2, len(names), channels.size))
        for row in rows:
            k = names.index(row["object"])
            counts[k] += row["count"]
            squared[k] += row["squared"]
            reference[k] += row["reference"]
        return cls(names, counts, squared, reference, channels)

    @classmethod
    def of_predictions(
        cls, objects: Sequence[str], predicted: Float64, labels: Float64, reference: Float64, channels: Channels
    ) -> Self:
        """Sum the squared errors of predictions by object.

        Args:
            objects: (S,) label of each sample.
            predicted: (S, D) predictions [counts].
            labels: (S, D) readings [counts].
            reference: (D,) or (S, D) predictions that have skill 0 [counts].
            channels: What the D values are.
        """
        return cls.of_rows(error_rows(objects, predicted, labels, reference), channels)

    @classmethod
    def pooled(cls, parts: Sequence[Self]) -> Self:
        """Add up errors of the same sensor, such as of several seeds."""
        columns = ("object", "count", "squared", "reference")
        errors = [zip(part.objects, part.counts, part.squared, part.reference, strict=True) for part in parts]
        rows = [dict(zip(columns, own, strict=True)) for one in errors for own in one]
        return cls.of_rows(rows, parts[0].channels)

    def only(self, name: str) -> Self:
        """Return the errors of one object."""
        k = [self.objects.index(name)]
        return type(self)((name,), self.counts[k], self.squared[k], self.reference[k], self.channels)

    def rmse(self) -> dict[str, float]:
        """Return the root of the mean squared error over all grasps and values, by modality [counts]."""
        mean = self.squared.sum(axis=0) / self.counts.sum()
        return {name: float(np.sqrt(value)) for name, value in _by_modality(mean, self.channels).items()}


def error_rows(objects: Sequence[str], predicted: Float64, labels: Float64, reference: Float64) -> list[dict[str, Any]]:
    """Return sums of squared errors as plain data, a row for each object; `ObjectErrors.of_rows` adds them up.

    Args:
        objects: (S,) names.
        predicted: (S, D) predictions [counts].
        labels: (S, D) labels [counts].
        reference: (S, D) or (D,) mean of the training labels, the reference of the skill [counts].

    Raises:
        DatasetError: If a prediction is not finite or missing.
    """
    if predicted.shape != labels.shape or not np.isfinite(predicted).all():
        raise DatasetError(f"predictions: shape {predicted.shape} or a value that is not finite")
    squared, base = (predicted - labels) ** 2, (reference - labels) ** 2
    return [
        {"object": str(name), "count": int(own.sum())}
        | {"squared": squared[own].sum(axis=0).tolist(), "reference": base[own].sum(axis=0).tolist()}
        for name in np.unique(objects)
        for own in [np.asarray(objects) == name]
    ]


@dataclass(frozen=True)
class ScoreEstimate:
    """A value over all objects with the `low` and `high` end of its interval, None where there are too few objects."""

    value: float
    low: float | None
    high: float | None

    @property
    def verdict(self) -> Verdict:
        """Of a difference: a tie if its interval contains 0."""
        if self.low is None or self.high is None:
            return "too few objects"
        if self.low > 0.0:
            return "better"
        return "worse" if self.high < 0.0 else "tie"


def skills(errors: ObjectErrors, config: BootstrapConfig = _DEFAULT) -> dict[str, ScoreEstimate]:
    """Return the skill by modality, and `MEAN`; raises `DatasetError` where the training mean is exact."""
    size = len(errors.objects)
    return _estimates(errors, _skill(errors, np.ones((1, size))), _skill(errors, _weights(size, config)))


def compare(errors: ObjectErrors, other: ObjectErrors, config: BootstrapConfig = _DEFAULT) -> dict[str, ScoreEstimate]:
    """Return the skill of `one` minus the skill of `other`, by modality and `MEAN`, in the same draws.

    Raises:
        DatasetError: If they were not tested on the same grasps against the same training means.
    """
    same = errors.objects == other.objects and np.array_equal(errors.counts, other.counts)
    if not same or not np.allclose(errors.reference, other.reference, rtol=1e-9):
        raise DatasetError("comparison: the two predictors were not tested on the same grasps")
    everyone = np.ones((1, len(errors.objects)))
    weights = _weights(len(errors.objects), config)
    value = _skill(errors, everyone) - _skill(other, everyone)
    return _estimates(errors, value, _skill(errors, weights) - _skill(other, weights))


def _skill(errors: ObjectErrors, weights: Float64) -> Float64:
    """Return (draws, M + 1): eq. 1 by modality, and the mean of the skills."""
    reference = weights @ errors.reference
    if not np.all(reference > 0.0):
        raise DatasetError("comparison: the training mean is exact, so the skill is undefined")
    per_value = 1.0 - (weights @ errors.squared) / reference
    skill = np.stack(list(_by_modality(per_value, errors.channels).values()), axis=1)
    return np.column_stack([skill, skill.mean(axis=1)])


def _by_modality(values: Float64, channels: Channels) -> dict[str, Float64]:
    """Return means over the values of each modality, by name, of (..., D)."""
    return {name: values[..., own].mean(axis=-1) for name, own in channels.modality_columns.items()}


def _weights(size: int, config: BootstrapConfig) -> Float64:
    """Return (draws, O): how often each object is drawn; no row where there are too few objects."""
    return np.empty((0, size)) if size < LEAST_OBJECTS else drawn_weights(size, config)


def drawn_weights(size: int, config: BootstrapConfig) -> Float64:
    """Return (draws, O): how often each of O objects is in a resample.

    Args:
        size: O.
        config: Number of resamples.
    """
    rng = np.random.default_rng(0)
    return rng.multinomial(size, np.full(size, 1.0 / size), config.draws).astype(np.float64)


def _estimates(errors: ObjectErrors, value: Float64, draws: Float64) -> dict[str, ScoreEstimate]:
    names = (*errors.channels.modalities, MEAN)
    if not len(draws):
        return {name: ScoreEstimate(float(value[0, k]), None, None) for k, name in enumerate(names)}
    tail = _tail(len(errors.objects))
    low, high = np.quantile(draws, [tail, 1.0 - tail], axis=0)
    return {name: ScoreEstimate(float(value[0, k]), float(low[k]), float(high[k])) for k, name in enumerate(names)}


def _tail(size: int) -> float:
    from scipy.stats import norm, t

    quantile = t.ppf(1.0 - _MISS / 2.0, size - 1)
    return float(norm.cdf(-np.sqrt(size / (size - 1)) * quantile))  # eq. 2
