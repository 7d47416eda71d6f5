# SPDX-License-Identifier: Apache-2.0
"""Calibration of a touch model from held-out predictions: online adaptation to touches, and intervals.

Two conditions, distinguished in prediction by the `unfamiliar` flag:

    known   objects in the training data, at another time: residuals of time-blocked folds
    new     objects outside the training data: residuals of objects left out, or of whole shapes

Whole shapes are left out where objects that no training object resembles will be met: on data of few shapes, an object
that is left out has many like it in training, so that its residuals are too small for a stranger.

Half widths are conformal with objects, or shapes, as the unit [Dunn, Wasserman and Ramdas 2022]: the scores |residual| / deviation
of all calibration objects are pooled, each object weighing the same, and cut at level (1 - α)(1 + 1/G) of G of them.
With few that level exceeds what their scores can show; it is capped at 0.95, and then no finite-sample
guarantee is given.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import DatasetError
from foretouch.models.calibration import Calibration, CalibrationGroup, tare_offset
from foretouch.types import Bool, Float64, Sample
from foretouch.types.channels import Channels
from foretouch_lab.learning.data import channels_of
from foretouch_lab.learning.data.folds import Fold, HoldOut, make_folds, object_folds, predict_folds
from foretouch_lab.learning.prequential import TimedReadings
from foretouch_lab.learning.training.tracker import fit_tracker, widen_unread

COVERAGE: Final = 0.9
_HIGHEST_LEVEL: Final = 0.95
_PRIOR_OBJECTS: Final = 30.0  # weight, in objects, of the prior that the errors of different values are uncorrelated
_LEAST_SHARE: Final = 0.05  # of W that B's diagonal keeps at least: no object's lasting error is exactly zero
_LEAST_DEVIATION: Final = 12.0**-0.5  # of errors and half widths, in units of the resolution: of rounding
_MOST_SHARE: Final = 1.0  # of W that B's diagonal has at most, for the scalars of new objects
_REST: Final = {1: 0.01, -1: 0.95, 0: 0.5}  # quantiles of the labels, by what contact does to a value

GUESSED: Final = "guessed from the labels"
"""Origin of a rest level without any tare."""

Names = npt.NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class HeldOutPredictions:
    """Predictions of samples by models that were fitted without them."""

    predicted: Float64  # (S, D) [counts]
    labels: Float64  # (S, D) [counts]
    objects: Names  # (S,) names of objects, or of the shapes that were left out as a whole
    sessions: Names  # (S,) the unit that shares the lasting part of the error: an object, or a block of its recording
    channels: Channels  # of the labels

    def take(self, chosen: Bool) -> Self:
        """Return the samples of an (S,) mask."""
        arrays = {name: array[chosen] for name, array in vars(self).items() if name != "channels"}
        return replace(self, **arrays)


def calibration_folds(
    samples: Sequence[Sample], seed: int, shapes: Sequence[str] | None = None, split: str = "object"
) -> dict[str, tuple[list[Fold], Names]]:
    """Return folds by which training samples are held out for a calibration.

    Where an object has fewer samples than there are blocks of time, random folds of the seed replace these.

    Args:
        samples: Training samples, of several objects.
        seed: Of the random folds.
        shapes: (S,) shape of each sample's object, where whole shapes are left out for `new`; by default objects are.
        split: What is left out for `new`, from `SPLITS`.

    Returns:
        `known` and `new`: folds, and (S,) sessions: blocks of the objects' recordings, or objects.

    Raises:
        DatasetError: If all samples are of one object.
    """
    objects = np.array([sample.object for sample in samples])
    try:
        time_folds = make_folds(samples, "time", seed)
    except DatasetError:
        time_folds = make_folds(samples, "random", seed)
    known = time_folds, _blocks(objects, time_folds)
    if split == "object":
        return {"known": known, "new": (object_folds(list(objects if shapes is None else shapes)), objects)}
    folds = make_folds(samples, split, seed)
    return {"known": known, "new": (folds, _blocks(objects, folds))}


def _blocks(objects: Names, folds: Sequence[Fold]) -> Names:
    """Return (S,) names of the part of each object's recording that a fold tests."""
    blocks = objects.astype(object)
    for fold in folds:
        blocks[fold.test] = [f"{name}/{fold.name}" for name in objects[fold.test]]
    return blocks.astype(np.str_)


def rest_level(samples: Sequence[Sample]) -> tuple[Float64, bool]:
    """Return sensor readings without contact, and whether they were measured.

    Without any tare they are estimated from the labels, value by value: those that contact raises from their low end,
    those that it lowers from their high end, others by their median. Of channels that are not tared they are 0.

    Returns:
        (D,) [counts]; True if it is the mean of recorded tares.
    """
    channels = channels_of(samples)
    tares = [sample.tare.values for sample in samples if sample.tare is not None]
    if tares:
        return np.where(channels.tared, np.mean(tares, axis=0), 0.0), True
    labels = np.array([sample.touch.values for sample in samples if sample.touch is not None])
    rest = np.zeros(channels.size)
    for name, channel in channels.channel_of.items():
        if channel.tared:
            column = channels.columns([name])
            rest[column] = np.quantile(labels[:, column], _REST[channel.contact], axis=0)
    return rest, False


def resting_labels(samples: Sequence[Sample], labels: Float64, rest: Float64) -> Float64:
    """Return (S, D) labels as sensors at rest level `rest` would have read them: shifted by the sample's tare, if any.

    Args:
        samples: S samples.
        labels: (S, D) their labels [counts].
        rest: (D,) rest level [counts].
    """
    shifted = labels.copy()
    for k, sample in enumerate(samples):
        if sample.tare is not None:
            shifted[k] -= tare_offset(sample.tare, rest)
    return shifted


def calibrate_on_folds(
    samples: Sequence[Sample],
    labels: Float64,
    predict: HoldOut,
    seed: int,
    *,
    where: Float64 | None = None,
    shapes: Sequence[str] | None = None,
    split: str = "object",
    workers: int = 1,
) -> tuple[Calibration, dict[str, Any]]:
    """Return a calibration from held-out predictions.

    Where all samples have a stamp, the parameters of the tracker of the sensors' state are fitted as well. Before any reading its
    intervals are about as wide as the conformal ones (`widen_unread`).

    Args:
        samples: Training samples, of several objects.
        labels: (S, D) [counts].
        predict: Fits to the training side of a fold and predicts its test side, at rest level.
        seed: Of the folds.
        where: (S, P) features of the grasps as of `Estimate`, for models that describe them.
        shapes: (S,) shape of each sample's object, as of `calibration_folds`.
        split: What is left out for `new`, as of `calibration_folds`.
        workers: Number of processes.

    Returns:
        As `make_calibration`; the facts also hold `rest`, the origin of the rest level, and `left_out`, the unit of
        `new`: `objects` or `shapes`.

    Raises:
        DatasetError: If all samples are of one object.
    """
    conditions = calibration_folds(samples, seed, shapes, split)
    predicted = predict_folds({name: (predict, folds) for name, (folds, _) in conditions.items()}, workers)
    channels = channels_of(samples)
    rest, recorded = rest_level(samples)
    objects = np.array([sample.object for sample in samples])
    left_out = {"known": objects, "new": objects if shapes is None else np.asarray(shapes, np.str_)}
    held_out = {
        name: HeldOutPredictions(predicted[name], labels, left_out[name], sessions, channels)
        for name, (_, sessions) in conditions.items()
    }
    calibration, facts = make_calibration(rest, held_out)
    facts["left_out"] = "objects" if shapes is None else "shapes"
    if all(sample.stamp_ns > 0 for sample in samples):
        recording = replace(TimedReadings.of_samples(samples, labels, predicted["new"], rest), where=where).ordered()
        groups = calibration.groups["new"], calibration.groups["known"]
        tracker = widen_unread(fit_tracker(recording, *groups), *(group.half_width for group in groups))
        calibration = replace(calibration, tracker=tracker)
    origin = "recorded tares" if recorded else GUESSED
    return calibration, {**facts, "rest": origin if channels.tared.any() else "zero by the sensor's description"}


def fit_group(held_out: HeldOutPredictions, *, new: bool = False) -> CalibrationGroup:
    """Return covariances of the lasting and the varying error, slope of differences, and half widths of one condition.

    B is estimated by the method of moments from the mean residual of each session; its correlations are shrunk to zero
    by G / (G + 30) for G objects, since 8 objects cannot determine 1225 of them. Where no session has two samples, the
    lasting part cannot be separated: then all of the error counts as new with each grasp, and touches do not narrow the
    intervals.

    With `new`, for objects outside these, the slope is shrunk by the same factor, since it was measured on G objects
    only; and B of the scalars of a finger, such as a pressure, of which one heavy object may make up most, is at most `_MOST_SHARE` of W.

    Args:
        held_out: Predictions of models that did not see the samples.
        new: Whether the group is for objects outside of the training.

    Raises:
        DatasetError: If there is no sample, or a residual is not finite or beyond `Channels.most`.
    """
    if len(held_out.labels) == 0:
        raise DatasetError("calibration: there is no sample")
    residuals, channels = held_out.labels - held_out.predicted, held_out.channels
    if not np.isfinite(residuals).all():
        raise DatasetError("calibration: a residual is not finite")
    if (np.abs(residuals) > channels.most).any():  # beyond, B + W/n may be singular
        k = int(np.argmax((np.abs(residuals) / channels.most).max(axis=0)))
        name = channels.modalities[channels.modality_of_value[k]]
        largest, unit = np.abs(residuals[:, k]).max(), channels.channel_of[name].unit
        raise DatasetError(f"calibration: {name}: a residual of {largest:g} {unit} exceeds {channels.most[k]:g}")
    least = _least_variance(channels)
    objects = len(np.unique(held_out.objects))
    shrinkage = objects / (objects + _PRIOR_OBJECTS)
    owners = [held_out.sessions == name for name in np.unique(held_out.sessions)]
    differences = _centred(held_out.predicted, owners)
    actual = _centred(held_out.labels, owners)
    slope = _slopes(differences, actual, channels) * (shrinkage if new else 1.0)
    spread = _spread(held_out)
    within = spread
    if freedom := len(residuals) - len(owners):
        within = np.maximum(((actual - slope * differences) ** 2).sum(axis=0) / freedom, least)
    means = np.array([residuals[mine].mean(axis=0) for mine in owners])
    smallest = float(np.mean([1.0 / mine.sum() for mine in owners]))
    moments = means.T @ means / len(means) - np.diag(within * smallest)
    between = _shrunk(moments, within, shrinkage)
    if new:
        single = [channel.size == 1 for channel in channels.channel_of.values()]
        most = np.where(channels.by_modality(single), _MOST_SHARE, np.inf)
        factor = np.sqrt(np.minimum(1.0, most * within / np.diag(between)))
        between = between * np.outer(factor, factor)
    return CalibrationGroup(channels, between, within, slope, spread, half_widths(held_out))


def _centred(values: Float64, owners: Sequence[Bool]) -> Float64:
    """Return (S, D) minus the mean of each session."""
    centred = values.copy()
    for mine in owners:
        centred[mine] -= values[mine].mean(axis=0)
    return centred


def _slopes(predicted: Float64, actual: Float64, channels: Channels) -> Float64:
    """Return (D,) least-squares slope of actual over predicted differences in standard units, one per modality, in [0, 1].

    It is 1 where no difference was predicted.
    """
    unit = np.maximum(actual.std(axis=0), 1e-6 * channels.resolution)
    slopes = np.empty(channels.size)
    for column in channels.modality_columns.values():
        x, y = predicted[:, column] / unit[column], actual[:, column] / unit[column]
        power = float((x * x).sum())
        slopes[column] = np.clip((x * y).sum() / power, 0.0, 1.0) if power > 1e-12 else 1.0
    return slopes


def _shrunk(moments: Float64, within: Float64, shrinkage: float) -> Float64:
    """Return the moments made positive definite, their correlations times `shrinkage`."""
    deviation = np.sqrt(np.maximum(np.diag(moments), _LEAST_SHARE * within))
    values, vectors = np.linalg.eigh(moments / np.outer(deviation, deviation))
    correlation = (vectors * np.maximum(values, 0.0)) @ vectors.T
    # Clipping has raised the diagonal; to set it alone to 1, below, would make B indefinite.
    size = np.sqrt(np.maximum(np.diag(correlation), 1.0))
    correlation /= np.outer(size, size)
    shrunk = shrinkage * correlation + (1.0 - shrinkage) * np.eye(len(deviation))
    np.fill_diagonal(shrunk, 1.0)
    return np.asarray(shrunk * np.outer(deviation, deviation), np.float64)


def conformal_level(objects: int) -> float:
    """Return the quantile of the scores of G calibration objects that covers one more object."""
    return min(COVERAGE * (1.0 + 1.0 / objects), _HIGHEST_LEVEL)


def _least_variance(channels: Channels) -> Float64:
    return np.asarray((_LEAST_DEVIATION * channels.resolution) ** 2, np.float64)


def _spread(held_out: HeldOutPredictions) -> Float64:
    """Return (D,) mean square of the residuals."""
    squared = (held_out.labels - held_out.predicted) ** 2
    return np.asarray(np.maximum(squared.mean(axis=0), _least_variance(held_out.channels)), np.float64)


def half_widths(held_out: HeldOutPredictions) -> Float64:
    """Return (D,) half widths [counts]: one factor per modality times the deviation of each value."""
    channels = held_out.channels
    names = held_out.objects
    deviation = np.sqrt(_spread(held_out))
    scores = np.abs(held_out.labels - held_out.predicted) / deviation
    level = conformal_level(len(np.unique(names)))
    half = np.empty(channels.size)
    for column in channels.modality_columns.values():
        half[column] = deviation[column] * _quantile_by_object(scores[:, column], names, level)
    # Where almost all residuals are zero, so is the quantile.
    return np.maximum(half, _LEAST_DEVIATION * channels.resolution)


def _quantile_by_object(scores: Float64, names: Names, level: float) -> float:
    """Return the quantile of pooled (S, M) scores where every object weighs the same, whatever its number of samples."""
    unique, index, counts = np.unique(names, return_inverse=True, return_counts=True)
    weight = np.repeat(1.0 / (len(unique) * counts[index] * scores.shape[1]), scores.shape[1])
    flat = scores.reshape(-1)
    order = np.argsort(flat)
    reached = np.cumsum(weight[order])
    return float(flat[order[min(int(np.searchsorted(reached, level)), len(order) - 1)]])


def make_calibration(rest: Float64, held_out: Mapping[str, HeldOutPredictions]) -> tuple[Calibration, dict[str, Any]]:
    """Return a calibration, and its facts for the card.

    Args:
        rest: (D,) rest level [counts].
        held_out: By name of the group, `known` and `new`.

    Returns:
        The calibration, and facts: `level`, and by group `objects`, `samples`, `cut` and `coverage` of objects left out
        of the calibration, by modality and by object.
    """
    regimes = {name: fit_group(predictions, new=name == "new") for name, predictions in held_out.items()}
    facts = {
        name: {
            "objects": len(np.unique(predictions.objects)),
            "samples": len(predictions.labels),
            "cut": round(conformal_level(len(np.unique(predictions.objects))), 4),
            "coverage": _coverage_by_object(predictions),
        }
        for name, predictions in held_out.items()
    }
    return Calibration(held_out["new"].channels, rest, regimes), {"level": COVERAGE, "regimes": facts}


def guarantee(calibration: Mapping[str, Any]) -> str:
    """Return one line for a card, from the facts of `calibrate_on_folds`: the coverage that this many objects or shapes can guarantee."""
    new, unit = calibration["regimes"]["new"], calibration["left_out"]
    count = new["objects"]
    if not new["coverage"]:
        return f"Intervals of {calibration['level']:.0%}: from 1 of the {unit}, so that their coverage of others was not measured."
    coverage = ", ".join(f"{name} {table['mean']:.2f}" for name, table in new["coverage"].items())
    least = min(min(table.values()) for table in new["coverage"].values())
    return (
        f"Intervals of {calibration['level']:.0%}: from {count} {unit}, a distribution-free guarantee for one more cannot exceed "
        f"{count / (count + 1):.0%}. Mean coverage of {unit} left out: {coverage}; of the worst of them {least:.2f}."
    )


def _coverage_by_object(held_out: HeldOutPredictions) -> dict[str, dict[str, float]]:
    """Return by modality the `mean` over objects, and each object's coverage by intervals calibrated on the others.

    Empty for a single object, which leaves none to calibrate on.
    """
    by_modality: dict[str, dict[str, float]] = {modality: {} for modality in held_out.channels.modalities}
    names = np.unique(held_out.objects)
    for name in names if len(names) > 1 else ():
        mine = held_out.take(held_out.objects == name)
        inside = np.abs(mine.labels - mine.predicted) <= half_widths(held_out.take(held_out.objects != name))
        for modality, shares in by_modality.items():
            shares[str(name)] = round(float(inside[:, held_out.channels.modality_columns[modality]].mean()), 3)
    return {
        modality: {"mean": round(float(np.mean(list(shares.values()))), 3), **shares}
        for modality, shares in by_modality.items()
        if shares
    }
