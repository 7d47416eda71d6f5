# SPDX-License-Identifier: Apache-2.0
"""Linear Gaussian model of what a reading differs from its prediction by, and its parameters.

    reading - prediction by vision = slow state of the sensor + fast state + object + noise of the grasp        (1)

The two states are Ornstein-Uhlenbeck processes: they drift, and revert to zero over a time constant (days for the slow
one, an hour for the fast one) [Uhlenbeck and Ornstein 1930]. The object's part is constant while the same object is
touched. A tare observes the slow state alone: the fast one, which single electrodes have on their own and by much more
than a resting sensor's noise, is taken for how hand and object lie, as the simulator takes it. (The public recordings have
no tare to decide this. Where tares were observed that do not read it, a filter whose tares read both states kept nothing
of it.) In the coordinates of a fixed basis in which all four
covariances are diagonal, (1) falls apart into 50 independent filters of three numbers each [Kalman 1960], so that a
reading and a prediction cost the same however many were before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.files import TensorRecord
from foretouch.tactile import MODALITIES
from foretouch.types import TOUCH_SIZE, Float64

FINGERS: Final = ("TH", "MF")
"""Thumb and middle finger."""

NEW, KNOWN = 0, 1
"""Rows of the arrays that differ between objects out of the training distribution and in it."""

SLOW_TIME_S: Final = 10.0 * 86400.0
FAST_TIME_S: Final = 3600.0
TARE_NOISE: Final = 0.1
"""Variance of a tare over that of a grasp, where no tares were recorded: assumed, not measured."""

_ALARM: Final = (10.0, 7.7)
"""Limits of the innovation test without a fit: of the mean square as on the public recordings, whose noise has heavier
tails than a Gaussian (2.0), and of the squared mean at their correlation of .84 within a finger (.84 · 9.14)."""

_PER_VALUE: Final = ("slow", "slow_time_s", "fast", "fast_time_s", "tare_noise")
_SHAPES: Final = {
    "basis": (TOUCH_SIZE, TOUCH_SIZE),
    **dict.fromkeys(_PER_VALUE, (TOUCH_SIZE,)),
    **dict.fromkeys(("object", "noise", "difference_shrinkage"), (2, TOUCH_SIZE)),
    "factor": (len(MODALITIES),),
    "alarm": (len(FINGERS), 2),
}
_BOUNDS: Final = {  # inclusive
    "slow": (0.0, 1e6),
    "fast": (0.0, 1e6),
    "object": (0.0, 1e6),
    "noise": (1e-3, 1e3),
    "tare_noise": (1e-6, 1e3),
    "slow_time_s": (1.0, 1e10),
    "fast_time_s": (1.0, 1e10),
    "difference_shrinkage": (0.0, 1.0),
    "factor": (0.1, 100.0),
    "alarm": (1e-3, 1e6),
    "basis": (-1e6, 1e6),
}
_TOUCHES: Final = (1, 10, 100, 1000)
_MAX_GAIN: Final = 10.0  # as of the calibration: counts per count of the largest residual
_MAX_CONDITION: Final = 1e6  # of the basis, its rows scaled to length 1


@dataclass(frozen=True, eq=False)
class TrackerParameters(TensorRecord):
    """Variances, time constants and basis of eq. 1, and of the intervals.

    Variances are in the coordinates of the basis, in units of the noise of a grasp on a new object.
    """

    basis: Float64  # (50, 50) [counts]: residual = basis @ coordinates
    slow: Float64  # (50,) variance of the slow state
    slow_time_s: Float64  # (50,) its time constant [s]
    fast: Float64  # (50,) variance of the fast state
    fast_time_s: Float64  # (50,) its time constant [s]
    object: Float64  # (2, 50) variance between objects, new and known
    noise: Float64  # (2, 50) variance of the noise of a grasp, on new and known objects
    tare_noise: Float64  # (50,) variance of a tare around the slow state
    difference_shrinkage: (
        Float64  # (2, 50) in [0, 1], shrinkage factor of predicted differences between grasps, per value
    )
    factor: (
        Float64  # (4,) by modality: half width of a 90 % interval over the predicted deviation, before it is adapted
    )
    alarm: Float64  # (2, 2) by finger: limits of the two statistics of the innovation test (`models.tracker`)

    @classmethod
    def from_calibration(
        cls,
        between: tuple[Float64, Float64],
        within: tuple[Float64, Float64],
        difference_shrinkage: tuple[Float64, Float64],
        factor: Float64,
    ) -> Self:
        """Of sensors without drift, from the statistics of residuals.

        After n touches of a new object with mean residual r its offset is then B (B + W/n)⁻¹ r, the multivariate
        empirical Bayes estimate [Efron and Morris 1973].

        The basis diagonalises B and W of new objects at the same time; of B and W of known ones only the diagonals are
        used. Variances beyond their bounds, as of a model without errors, are set to these.

        Args:
            between: B of new and of known objects, (50, 50) each [counts²].
            within: W of both, (50,) each [counts²].
            difference_shrinkage: Of both, (50,) each.
            factor: (4,) as of the record.
        """
        scale = np.sqrt(within[NEW])
        values, vectors = np.linalg.eigh(between[NEW] / np.outer(scale, scale))
        inverse = (vectors / scale[:, None]).T
        known_object = np.einsum("ki,ij,kj->k", inverse, between[KNOWN], inverse)
        known_noise = (inverse**2) @ within[KNOWN]
        return cls(
            basis=scale[:, None] * vectors,
            slow=np.zeros(TOUCH_SIZE),
            slow_time_s=np.full(TOUCH_SIZE, SLOW_TIME_S),
            fast=np.zeros(TOUCH_SIZE),
            fast_time_s=np.full(TOUCH_SIZE, FAST_TIME_S),
            object=np.clip([values, known_object], *_BOUNDS["object"]),
            noise=np.clip([np.ones(TOUCH_SIZE), known_noise], *_BOUNDS["noise"]),
            tare_noise=np.full(TOUCH_SIZE, TARE_NOISE),
            difference_shrinkage=np.array(difference_shrinkage),
            factor=factor,
            alarm=np.tile(_ALARM, (len(FINGERS), 1)),
        )

    def _check(self) -> None:
        for name, shape in _SHAPES.items():
            array, (low, high) = getattr(self, name), _BOUNDS[name]
            if array.shape != shape or array.dtype != np.float64:
                raise ModelError(f"{name}: {array.dtype} {array.shape} is not float64 {shape}")
            if not ((array >= low) & (array <= high)).all():  # NaN fails too
                raise ModelError(f"{name}: holds a value that is not within [{low:g}, {high:g}]")
        length = np.linalg.norm(self.basis, axis=1)
        if not (length > 0.0).all() or not np.linalg.cond(self.basis / length[:, None]) < _MAX_CONDITION:
            raise ModelError(f"basis: is singular, or its condition exceeds {_MAX_CONDITION:g}")
        inverse = np.linalg.inv(self.basis)
        for row in (NEW, KNOWN):
            total = self.slow + self.fast + self.object[row]
            for count in _TOUCHES:
                gain = (self.basis * (total / (total + self.noise[row] / count))) @ inverse
                if not (largest := float(np.abs(gain).sum(axis=1).max())) <= _MAX_GAIN:
                    rule = f"{count} touches turn residuals of at most 1 into {largest:.3g}, {_MAX_GAIN:g} is allowed"
                    raise ModelError(f"basis, object: {rule}")


class StateFilter:
    """K independent Kalman filters of (1): slow state, fast state and object's part of each coordinate.

    Args:
        prior: (3, K) variances of the parts before any reading.
        times_s: (2, K) time constants of the two states [s].

    Attributes:
        mean: (3, K) of the parts.
        covariance: (3, 3, K) of the parts.
    """

    def __init__(self, prior: Float64, times_s: Float64) -> None:
        self.prior = prior
        self.times_s = times_s
        self.mean = np.zeros_like(prior)
        self.covariance = np.zeros((3, *prior.shape))
        self.restart(np.arange(prior.shape[1]))

    def copy(self) -> StateFilter:
        """An independent filter in the same state."""
        twin = StateFilter.__new__(StateFilter)
        twin.prior, twin.times_s = self.prior.copy(), self.times_s
        twin.mean, twin.covariance = self.mean.copy(), self.covariance.copy()
        return twin

    def advance(self, seconds: float) -> None:
        """Let time pass: the states decay to zero, and their variances return to the prior ones."""
        if seconds <= 0.0:
            return
        decay = np.exp(-seconds / self.times_s)
        lost = -np.expm1(-2.0 * seconds / self.times_s)  # 1 - decay², without cancellation
        self.mean[:2] *= decay
        self.covariance[:2] *= decay[:, None]
        self.covariance[:, :2] *= decay
        self.covariance[0, 0] += self.prior[0] * lost[0]
        self.covariance[1, 1] += self.prior[1] * lost[1]

    def start_object(self, variance: Float64) -> None:
        """Forget the object's part; that of the next one has a (K,) prior variance."""
        self.prior[2] = variance
        self.mean[2] = 0.0
        self.covariance[2] = 0.0
        self.covariance[:, 2] = 0.0
        self.covariance[2, 2] = variance

    def restart(self, chosen: np.ndarray) -> None:
        """Forget everything about some coordinates, given by their indices or a (K,) mask."""
        self.mean[:, chosen] = 0.0
        self.covariance[:, :, chosen] = 0.0
        for part in range(3):
            self.covariance[part, part, chosen] = self.prior[part, chosen]

    def predicted(self, parts: int = 3) -> tuple[Float64, Float64]:
        """(K,) mean and variance of the sum of the parts; with `parts` 1, of the slow state alone."""
        return self.mean[:parts].sum(axis=0), self.covariance[:parts, :parts].sum(axis=(0, 1))

    def observe(self, value: Float64, noise: Float64, parts: int = 3) -> None:
        """Add (K,) observations of the sum of the parts with (K,) variances; infinite ones are of no effect."""
        mean, variance = self.predicted(parts)
        cross = self.covariance[:, :parts].sum(axis=1)
        total = variance + noise
        self.mean += cross * ((value - mean) / total)
        self.covariance -= cross[:, None] * (cross / total)
