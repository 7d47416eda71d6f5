# SPDX-License-Identifier: Apache-2.0
"""Adaptation of predictions to tactile readings, and calibrated prediction intervals; and their file beside a model.

The residuals of a model on one object have a part that stays for that object and day, of covariance B, and a part that
is new with each grasp, of variance W. After n readings with mean residual r, the best linear estimate of the lasting
part is B (B + W/n)⁻¹ r (the multivariate empirical Bayes estimator [Efron and Morris 1973]): closed form, a 50 x 50
system, no training. Once an object was touched, predicted differences between two grasps on it are multiplied by a
shrinkage factor (`worth`), because on a new object the actual differences are smaller than predicted.

Intervals are conformal with objects as the exchangeable unit: half widths cover the requested share of residuals,
with equal weight for each calibration object (`learning.training.calibration`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError
from foretouch.models.card import card_text, read_card
from foretouch.models.files import TensorRecord, file_beside, packed, read_part, read_tensors, replace_files
from foretouch.models.novelty import Fallback
from foretouch.models.state_space import TrackerParameters
from foretouch.tactile import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64

GROUPS: Final = ("known", "new", "known_tare", "new_tare")
"""Objects in or out of the training distribution, each predicted without a tare or with one."""

_POSITIVE: Final = ("within", "spread", "half_width")
_FALLBACK: Final = "fallback/"
_TRACKER: Final = "tracker/"
_TOUCHES: Final = (1, 10, 100, 1000)  # counts of touches at which an adaptation is checked
_MAX_GAIN: Final = 10.0  # of a mean residual; the released models reach 2.5
_MAX_VALUE: Final = 1e12  # [counts²]; readings have at most 4095 counts
_MAX_CONDITION: Final = 1e12  # of B + W/n; that of the released models is below 200


@dataclass(frozen=True, eq=False)
class CalibrationGroup(TensorRecord):
    """Statistics of the residuals under one condition.

    Attributes:
        between: (50, 50) float64 [counts²], B: covariance of the part that stays with an object and its day.
        within: (50,) float64 [counts²], W: variance of the part that is new with each grasp, after shrinkage of the
            predicted differences.
        worth: (50,) float64 in [0, 1], shrinkage factor of predicted differences between two grasps on an object.
        spread: (50,) float64 [counts²], variance of the residuals before any touch.
        half_width: (50,) float64 [counts], of the interval before any touch.
    """

    between: Float64
    within: Float64
    worth: Float64
    spread: Float64
    half_width: Float64

    def counts_after(self, expected: Float64, mean_expected: Float64, mean_reading: Float64, count: int) -> Float64:
        """Predictions adapted to some touches.

        Args:
            expected: (K, 50) predictions before any touch [counts].
            mean_expected: (50,) mean of the predictions, before any touch, at the touched grasps [counts].
            mean_reading: (50,) mean of the readings there [counts].
            count: Number of touches; with none the predictions are returned unchanged.
        """
        if count == 0:
            return expected
        gain = np.linalg.solve(self.between + np.diag(self.within / count), mean_reading - mean_expected)
        return np.asarray(mean_expected + self.between @ gain + self.worth * (expected - mean_expected), np.float64)

    def half_width_after(self, count: int) -> Float64:
        """(50,) half width after `count` touches [counts]: scaled with the remaining deviation, never widened."""
        if count == 0:
            return self.half_width
        solved = np.linalg.solve(self.between + np.diag(self.within / count), self.between)
        lasting = np.diag(self.between) - np.einsum("ij,ji->i", self.between, solved)
        left = (np.maximum(lasting, 0.0) + self.within) / self.spread
        return np.asarray(self.half_width * np.sqrt(np.minimum(left, 1.0)), np.float64)

    def _check(self) -> None:
        for name, array in self.to_tensors().items():
            _check_array(name, array)
            if np.abs(array).max() > _MAX_VALUE:
                raise ModelError(f"{name}: {np.abs(array).max():.3g} exceeds {_MAX_VALUE:g}, the square of 1e6 counts")
        tolerance = 1e-6 * np.abs(self.between).max()
        if np.abs(self.between - self.between.T).max() > tolerance:
            raise ModelError("between: is not symmetric")
        if np.linalg.eigvalsh(self.between)[0] < -tolerance:
            raise ModelError("between: is no covariance: it has a negative eigenvalue")
        self._check_amplification()
        if self.worth.min() < 0.0 or self.worth.max() > 1.0:
            raise ModelError("worth: leaves [0, 1]")

    def _check_amplification(self) -> None:
        """Refuse an adaptation that is singular, or that makes more of a residual than is there.

        In units of the deviations of W, a touch moves the predictions by A (A + 1)⁻¹ of the residual, where A is B in
        these units: less than 1 in every direction. In counts, a channel can move by more than the largest residual,
        since correlated channels with less noise vouch for it; beyond `_MAX_GAIN` times it, B and W were not estimated
        together.
        """
        for count in _TOUCHES:
            total = self.between + np.diag(self.within / count)
            with np.errstate(all="ignore"):
                condition = float(np.linalg.cond(total))
            if not condition < _MAX_CONDITION:
                rule = f"B + W/{count} is singular: its condition is {condition:.3g}, {_MAX_CONDITION:g} is allowed"
                raise ModelError(f"between, within: {rule}")
            largest = float(np.abs(np.linalg.solve(total, self.between)).sum(axis=0).max())
            if not largest <= _MAX_GAIN:
                rule = f"B (B + W/{count})^-1 turns residuals of at most 1 into {largest:.3g}, {_MAX_GAIN:g} is allowed"
                raise ModelError(f"between, within: {rule}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """Rest level, adaptation and intervals of one model.

    Attributes:
        rest: (50,) float64 [counts]: readings of the training sensors without contact. A tare shifts predictions by its
            difference from it.
        groups: By name from `GROUPS`; "known" and "new" always exist, the others where tares were recorded.
        tracker: Of the sensors' state, fitted to recordings with stamps; None in calibrations without.
    """

    rest: Float64
    groups: Mapping[str, CalibrationGroup]
    tracker: TrackerParameters | None = None

    def tracker_parameters(self) -> TrackerParameters:
        """The fitted ones, or else those of a sensor without drift, whose tracker adapts to touches as `adapt` does."""
        if self.tracker is not None:
            return self.tracker
        new, known = self.groups["new"], self.groups["known"]
        ratio = new.half_width / np.sqrt(new.spread)
        return TrackerParameters.from_memory(
            (new.between, known.between),
            (new.within, known.within),
            (new.worth, known.worth),
            np.array([ratio[columns([name])].mean() for name in MODALITIES]),
        )

    def group(self, *, in_distribution: bool, tare: bool) -> CalibrationGroup:
        """The group of a prediction; if training had no recorded tares, the one without a tare serves for both."""
        name = "known" if in_distribution else "new"
        return self.groups.get(f"{name}_tare" if tare else name, self.groups[name])

    def adapt(
        self,
        expected: Float64,
        in_distribution: npt.NDArray[np.bool_],
        *,
        tare: bool,
        touched: tuple[Float64, Float64] | None = None,
        count: int = 0,
    ) -> tuple[Float64, Float64]:
        """Adapt predictions to touches, and compute the half widths of their intervals.

        Args:
            expected: (K, 50) before any touch, shifted by the tare if there is one [counts].
            in_distribution: (K,) whether each resembles the training data.
            tare: Whether there is one.
            touched: (50,) means of the predictions and of the readings at the touched grasps [counts].
            count: Number of touches.

        Returns:
            (K, 50) predictions and (K, 50) half widths [counts].
        """
        counts, half = expected.copy(), np.empty_like(expected)
        for inside in (False, True):
            group, rows = self.group(in_distribution=inside, tare=tare), in_distribution == inside
            if not rows.any():
                continue
            if touched is not None:
                counts[rows] = group.counts_after(expected[rows], *touched, count)
            half[rows] = group.half_width_after(count)
        return counts, half

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        tensors: dict[str, npt.NDArray[Any]] = {"rest": self.rest}
        for name, group in self.groups.items():
            tensors |= {f"{name}/{field}": array for field, array in group.to_tensors().items()}
        if self.tracker is not None:
            tensors |= {_TRACKER + field: array for field, array in self.tracker.to_tensors().items()}
        return tensors

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]]) -> Calibration:
        """From `to_tensors`.

        Raises:
            ModelError: Names the array that is missing, of another shape or not finite, or no variance, width,
                shrinkage factor or covariance.
        """
        if "rest" not in tensors:
            raise ModelError("rest: is missing")
        tensors = {name: np.asarray(array, np.float64) for name, array in tensors.items()}
        _check_array("rest", tensors["rest"])
        names = [name for name in GROUPS if name in ("known", "new") or f"{name}/between" in tensors]
        tracked = any(name.startswith(_TRACKER) for name in tensors)
        tracker = read_part(TrackerParameters, tensors, _TRACKER) if tracked else None
        return cls(tensors["rest"], {name: read_part(CalibrationGroup, tensors, f"{name}/") for name in names}, tracker)


def _check_array(name: str, array: npt.NDArray[Any]) -> None:
    shape = (TOUCH_SIZE, TOUCH_SIZE) if name == "between" else (TOUCH_SIZE,)
    if array.shape != shape:
        raise ModelError(f"{name}: shape {array.shape} is not {shape}")
    positive = name in _POSITIVE
    if not np.isfinite(array).all() or (positive and not (array > 0.0).all()):
        raise ModelError(f"{name}: holds a value that is not finite{' and above 0' if positive else ''}")


def add_calibration(
    card_path: Path, calibration: Calibration, facts: Mapping[str, Any], fallback: Fallback | None = None
) -> None:
    """Write a calibration beside a model and name it in the model's card.

    Args:
        card_path: The card of a network or a contact model.
        calibration: Stored in `<name>.trust.safetensors`.
        facts: `level`, `regimes` (objects and coverage by group) and `rest`, for the card.
        fallback: Of a network, stored in the same file.

    Raises:
        ModelError: If the card cannot be read.
        FileError: If a file cannot be written; the files before are kept.
    """
    card = read_card(card_path)
    files = calibration_file(card_path, card, calibration, facts, fallback)
    replace_files({**files, card_path: card_text(card).encode()})


def calibration_file(
    card_path: Path,
    card: dict[str, Any],
    calibration: Calibration,
    facts: Mapping[str, Any],
    fallback: Fallback | None = None,
) -> dict[Path, bytes]:
    """`<name>.trust.safetensors` with its content.

    Adds its name and hash to the card. Arguments as in `add_calibration`.
    """
    tensors = calibration.to_tensors()
    if fallback is not None:
        tensors |= {_FALLBACK + key: value for key, value in fallback.to_tensors().items()}
    path = card_path.with_name(f"{card_path.stem}.trust.safetensors")
    content, sha256 = packed(tensors)
    card["calibration"] = {"weights": path.name, "sha256": sha256, **facts}
    return {path: content}


def load_calibration(card_path: Path, card: Mapping[str, Any]) -> tuple[Calibration | None, Fallback | None]:
    """The calibration that a card names, and the fallback in the same file; None where there is none.

    Raises:
        ModelError: Names the file and the field: absent, damaged, with another hash than the card's, or not fitting.
    """
    facts = card.get("calibration")
    if facts is None:
        return None, None
    for field in ("weights", "sha256"):
        if not isinstance(facts.get(field), str):
            raise ModelError(f"{card_path}: calibration.{field}: is missing")
    path = file_beside(card_path, facts["weights"], "calibration.weights")
    tensors = read_tensors(path, facts["sha256"], card_path.name)
    fallback = {key.removeprefix(_FALLBACK): value for key, value in tensors.items() if key.startswith(_FALLBACK)}
    try:
        return Calibration.from_tensors(tensors), Fallback.from_tensors(fallback) if fallback else None
    except ModelError as err:
        raise ModelError(f"{path}: {err}") from err
