# SPDX-License-Identifier: Apache-2.0
"""What to make of a model's raw predictions: what a tare and a few touches change, and how wide to doubt.

Residuals of a model on one object have a part that stays for that object and day, of covariance B, and a part that is new
with each grasp, of variance W. After n readings with mean residual r the best linear guess of the lasting part is
B (B + W/n)⁻¹ r (the multivariate empirical Bayes estimator [Efron and Morris 1973]): closed form, a 50 x 50 system, no
training. Once an object was touched, what the model says of the difference between two grasps on it counts for its worth
alone: on a new object such differences hold less often than the model believes.

Intervals are conformal with objects as the unit of exchange: half widths hold the share of residuals that they were asked
to, with each calibration object weighing the same (`learning.calibration`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError
from foretouch.types import TOUCH_SIZE, Float64

__all__ = ["REGIMES", "Calibration", "CalibrationGroup"]

REGIMES: Final = ("known", "new", "known_tare", "new_tare")
"""Objects like those of training or unlike them; with a tare at hand or without."""

_FIELDS: Final = ("between", "within", "worth", "spread", "half_width")
_POSITIVE: Final = ("within", "spread", "half_width")


@dataclass(frozen=True, eq=False)
class CalibrationGroup:
    """How residuals behave under one condition.

    Attributes:
        between: (50, 50) float64 [counts²], B: covariance of the part that stays with an object and its day.
        within: (50,) float64 [counts²], W: variance of the part that is new with each grasp, once predicted differences
            count for their worth.
        worth: (50,) float64 in [0, 1], how much of a predicted difference between two grasps on an object holds.
        spread: (50,) float64 [counts²], variance of the residuals before any touch.
        half_width: (50,) float64 [counts], of the interval before any touch.
    """

    between: Float64
    within: Float64
    worth: Float64
    spread: Float64
    half_width: Float64

    def after(self, expected: Float64, mean_expected: Float64, mean_reading: Float64, count: int) -> Float64:
        """Predictions after some touches.

        Args:
            expected: (K, 50) predictions before any touch [counts].
            mean_expected: (50,) mean of what was predicted, before any touch, at the touched grasps [counts].
            mean_reading: (50,) mean of what was read there [counts].
            count: Touches; with none the predictions come back as they are.
        """
        if count == 0:
            return expected
        gain = np.linalg.solve(self.between + np.diag(self.within / count), mean_reading - mean_expected)
        return np.asarray(mean_expected + self.between @ gain + self.worth * (expected - mean_expected), np.float64)

    def half_width_after(self, count: int) -> Float64:
        """(50,) half width after `count` readings [counts]: narrowed as the deviation that remains is, never widened."""
        if count == 0:
            return self.half_width
        solved = np.linalg.solve(self.between + np.diag(self.within / count), self.between)
        lasting = np.diag(self.between) - np.einsum("ij,ji->i", self.between, solved)
        left = (np.maximum(lasting, 0.0) + self.within) / self.spread
        return np.asarray(self.half_width * np.sqrt(np.minimum(left, 1.0)), np.float64)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Of one model.

    Attributes:
        rest: (50,) float64 [counts]: what the training sensors read without contact. A tare shifts predictions by its
            difference from it.
        regimes: By name out of `REGIMES`; "known" and "new" are always there, the others where tares were recorded.
    """

    rest: Float64
    regimes: Mapping[str, CalibrationGroup]

    def regime(self, *, familiar: bool, tare: bool) -> CalibrationGroup:
        """That of a prediction; without recorded tares in training, that without a tare serves for both."""
        name = "known" if familiar else "new"
        return self.regimes.get(f"{name}_tare" if tare else name, self.regimes[name])

    def lean(
        self,
        expected: Float64,
        familiar: npt.NDArray[np.bool_],
        *,
        tare: bool,
        touched: tuple[Float64, Float64] | None = None,
        count: int = 0,
    ) -> tuple[Float64, Float64]:
        """Predictions and half widths from what a model expects.

        Args:
            expected: (K, 50) before any touch, shifted by the tare if there is one [counts].
            familiar: (K,) whether each is of a familiar object.
            tare: Whether there is one.
            touched: (50,) means of what was expected and of what was read at the touched grasps [counts].
            count: Of the touches.

        Returns:
            (K, 50) and (K, 50) [counts].
        """
        counts, half = expected.copy(), np.empty_like(expected)
        for known in np.unique(familiar):
            regime, mine = self.regime(familiar=bool(known), tare=tare), familiar == known
            if touched is not None:
                counts[mine] = regime.after(expected[mine], *touched, count)
            half[mine] = regime.half_width_after(count)
        return counts, half

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        tensors: dict[str, npt.NDArray[Any]] = {"rest": self.rest}
        for name, regime in self.regimes.items():
            tensors |= {f"{name}/{field}": getattr(regime, field) for field in _FIELDS}
        return tensors

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]]) -> Calibration:
        """From `to_tensors`.

        Raises:
            ModelError: If an array is missing, of another shape or not finite, a variance or width is not above 0, a worth
                leaves [0, 1], or a covariance is none.
        """
        regimes = {
            name: CalibrationGroup(**{field: _checked(tensors, f"{name}/{field}") for field in _FIELDS})
            for name in REGIMES
            if name in ("known", "new") or f"{name}/between" in tensors
        }
        for name, regime in regimes.items():
            tolerance = 1e-6 * np.abs(regime.between).max()
            if np.abs(regime.between - regime.between.T).max() > tolerance:
                raise ModelError(f"{name}/between: is not symmetric")
            if np.linalg.eigvalsh(regime.between)[0] < -tolerance:
                raise ModelError(f"{name}/between: is no covariance, for it has a negative eigenvalue")
            if regime.worth.min() < 0.0 or regime.worth.max() > 1.0:
                raise ModelError(f"{name}/worth: leaves [0, 1]")
        return cls(_checked(tensors, "rest"), regimes)


def _checked(tensors: Mapping[str, npt.NDArray[Any]], name: str) -> Float64:
    if name not in tensors:
        raise ModelError(f"{name}: is missing")
    found = np.asarray(tensors[name], np.float64)
    field = name.rpartition("/")[2]
    shape = (TOUCH_SIZE, TOUCH_SIZE) if field == "between" else (TOUCH_SIZE,)
    if found.shape != shape:
        raise ModelError(f"{name}: shape {found.shape} is not {shape}")
    positive = field in _POSITIVE
    if not np.isfinite(found).all() or (positive and not (found > 0.0).all()):
        raise ModelError(f"{name}: holds a value that is not finite{' and above 0' if positive else ''}")
    return found
