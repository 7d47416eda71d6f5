# SPDX-License-Identifier: Apache-2.0
"""From predictions of held-out samples to a model's `Calibration`: what touches teach, and how wide to doubt.

Two conditions, told apart in prediction by the `unfamiliar` flag:

    known   objects that were trained on, at a time that was not: residuals of time-blocked folds
    new     objects that were not: residuals of objects left out

Half widths are conformal with objects as the unit [Dunn, Wasserman and Ramdas 2022]: the scores |residual| / deviation of all
calibration objects are pooled, each object weighing the same, and cut at level (1 - α)(1 + 1/G) of G objects. With few
objects that level exceeds what they hold; it is capped at 0.95, and then no finite-sample promise is made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.models.calibration import Calibration, CalibrationGroup
from foretouch.tactile import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64

__all__ = [
    "COVERAGE",
    "HeldOutPredictions",
    "conformal_level",
    "coverage_by_object",
    "fit_group",
    "make_calibration",
    "promise",
]

COVERAGE: Final = 0.9
_HIGHEST_LEVEL: Final = 0.95
_PRIOR_OBJECTS: Final = 30.0  # as many objects' worth of belief that errors tell nothing of each other on new objects
_LEAST_SHARE: Final = 0.05  # of W that B's diagonal keeps at least: an object is never known to err by nothing

Names = npt.NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class HeldOutPredictions:
    """Predictions of samples by models that were fitted without them.

    Attributes:
        predicted: (S, 50) [counts].
        labels: (S, 50) [counts].
        objects: (S,) names.
        sessions: (S,) what a lasting part of the error belongs to: an object, or a stretch of its recording.
    """

    predicted: Float64
    labels: Float64
    objects: Names
    sessions: Names

    def take(self, chosen: npt.NDArray[np.bool_]) -> HeldOutPredictions:
        """Those of the (S,) mask."""
        return HeldOutPredictions(
            self.predicted[chosen], self.labels[chosen], self.objects[chosen], self.sessions[chosen]
        )


def fit_group(held_out: HeldOutPredictions, *, new: bool = False) -> CalibrationGroup:
    """Covariances of the lasting part and of the rest, the worth of differences, and conformal half widths.

    B is estimated by the method of moments from the mean residual of each session; its correlations are shrunk to zero
    by G / (G + 30) for G objects, for 8 objects cannot tell 1225 of them. Where no session holds two samples nothing tells
    the lasting part from the rest: then all of the error counts as new with each grasp, and touches narrow nothing.

    Args:
        held_out: Predictions of one condition.
        new: Whether it speaks of objects beyond these. Then the worth is shrunk by the same factor, for what differences
            were worth on G objects is known of those alone.
    """
    trusted = _trusted(held_out.objects)
    residuals = held_out.labels - held_out.predicted
    owners = [held_out.sessions == name for name in np.unique(held_out.sessions)]
    differences = _centred(held_out.predicted, owners)
    actual = _centred(held_out.labels, owners)
    worth = _worth(differences, actual) * (trusted if new else 1.0)
    spread = np.maximum((residuals**2).mean(axis=0), 1e-6)
    freedom = len(residuals) - len(owners)
    within = np.maximum(((actual - worth * differences) ** 2).sum(axis=0) / freedom, 1e-6) if freedom else spread
    means = np.array([residuals[mine].mean(axis=0) for mine in owners])
    smallest = float(np.mean([1.0 / mine.sum() for mine in owners]))
    moments = means.T @ means / len(means) - np.diag(within * smallest)
    between = _shrunk(moments, within, trusted)
    return CalibrationGroup(between, within, worth, spread, _half_widths(residuals, held_out.objects, np.sqrt(spread)))


def _centred(values: Float64, owners: Sequence[npt.NDArray[np.bool_]]) -> Float64:
    """(S, 50) less the mean of each session."""
    centred = values.copy()
    for mine in owners:
        centred[mine] -= values[mine].mean(axis=0)
    return centred


def _worth(predicted: Float64, actual: Float64) -> Float64:
    """(50,) least-squares slope of actual over predicted differences in standard units, one a modality, within [0, 1].

    1 where no difference was predicted, which is no reason to doubt one.
    """
    unit = np.maximum(actual.std(axis=0), 1e-6)
    worth = np.empty(TOUCH_SIZE)
    for modality in MODALITIES:
        place = columns([modality])
        x, y = predicted[:, place] / unit[place], actual[:, place] / unit[place]
        power = float((x * x).sum())
        worth[place] = np.clip((x * y).sum() / power, 0.0, 1.0) if power > 1e-12 else 1.0
    return worth


def _trusted(names: Names) -> float:
    """G / (G + 30) of G objects."""
    objects = len(np.unique(names))
    return objects / (objects + _PRIOR_OBJECTS)


def _shrunk(moments: Float64, within: Float64, trusted: float) -> Float64:
    """The moments made positive definite, their correlations times `trusted`."""
    deviation = np.sqrt(np.maximum(np.diag(moments), _LEAST_SHARE * within))
    values, vectors = np.linalg.eigh(moments / np.outer(deviation, deviation))
    correlation = (vectors * np.maximum(values, 0.0)) @ vectors.T
    # What was cut off has raised the diagonal; to lower it alone to 1, below, would make B indefinite.
    size = np.sqrt(np.maximum(np.diag(correlation), 1.0))
    correlation /= np.outer(size, size)
    shrunk = trusted * correlation + (1.0 - trusted) * np.eye(TOUCH_SIZE)
    np.fill_diagonal(shrunk, 1.0)
    return np.asarray(shrunk * np.outer(deviation, deviation), np.float64)


def conformal_level(objects: int, coverage: float = COVERAGE) -> float:
    """The quantile that G calibration objects have to be cut at for one more object to be covered."""
    return min(coverage * (1.0 + 1.0 / objects), _HIGHEST_LEVEL)


def _half_widths(residuals: Float64, names: Names, deviation: Float64) -> Float64:
    """(50,) half widths [counts]: one factor a modality over the deviation of each value."""
    scores = np.abs(residuals) / deviation
    level = conformal_level(len(np.unique(names)))
    half = np.empty(TOUCH_SIZE)
    for modality in MODALITIES:
        place = columns([modality])
        half[place] = deviation[place] * _quantile_by_object(scores[:, place], names, level)
    return half


def _quantile_by_object(scores: Float64, names: Names, level: float) -> float:
    """Quantile of pooled (S, M) scores where every object weighs the same, however many samples it has."""
    unique, index, counts = np.unique(names, return_inverse=True, return_counts=True)
    weight = np.repeat(1.0 / (len(unique) * counts[index] * scores.shape[1]), scores.shape[1])
    flat = scores.reshape(-1)
    order = np.argsort(flat)
    reached = np.cumsum(weight[order])
    return float(flat[order[min(int(np.searchsorted(reached, level)), len(order) - 1)]])


def make_calibration(rest: Float64, held_out: Mapping[str, HeldOutPredictions]) -> tuple[Calibration, dict[str, Any]]:
    """A calibration, and what its card should tell.

    Args:
        rest: (50,) [counts].
        held_out: By regime.

    Returns:
        The trust, and facts: `level`, and by regime `objects`, `samples`, `cut` and `coverage` of objects left out of the
        calibration, by modality and by object.
    """
    regimes = {name: fit_group(one, new=name.startswith("new")) for name, one in held_out.items()}
    facts: dict[str, Any] = {"level": COVERAGE, "regimes": {}}
    for name, one in held_out.items():
        objects = len(np.unique(one.objects))
        facts["regimes"][name] = {
            "objects": objects,
            "samples": len(one.labels),
            "cut": round(conformal_level(objects), 4),
            "coverage": coverage_by_object(one),
        }
    return Calibration(rest, regimes), facts


def promise(calibration: Mapping[str, Any]) -> str:
    """One line for a card, from the facts of `make_calibration`: what that many objects can promise of the intervals."""
    new = calibration["regimes"]["new"]
    objects = new["objects"]
    found = ", ".join(f"{name} {table['mean']:.2f}" for name, table in new["coverage"].items())
    least = min(min(table.values()) for table in new["coverage"].values())
    return (
        f"Intervals of {calibration['level']:.0%}: of {objects} objects, a distribution-free promise for one more cannot exceed "
        f"{objects / (objects + 1):.0%}. Objects left out were covered on average: {found}; the worst of them {least:.2f}."
    )


def coverage_by_object(held_out: HeldOutPredictions) -> dict[str, dict[str, float]]:
    """By modality: `mean` over objects, and each object's coverage by intervals calibrated on the others.

    One object alone has nothing to be calibrated on, and gives no figures.
    """
    found: dict[str, dict[str, float]] = {modality: {} for modality in MODALITIES}
    everyone = np.unique(held_out.objects)
    for name in everyone if len(everyone) > 1 else ():
        mine = held_out.take(held_out.objects == name)
        half = fit_group(held_out.take(held_out.objects != name)).half_width
        inside = np.abs(mine.labels - mine.predicted) <= half
        for modality in MODALITIES:
            found[modality][str(name)] = round(float(inside[:, columns([modality])].mean()), 3)
    return {
        modality: {"mean": round(float(np.mean(list(shares.values()))), 3), **shares}
        for modality, shares in found.items()
        if shares
    }
