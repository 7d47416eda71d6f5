# SPDX-License-Identifier: Apache-2.0
"""Linear Gaussian model of what a reading differs from its prediction by, and its parameters.

    reading - prediction by vision = slow state of the sensor + fast state + object + slope · x + noise of the grasp   (1)

The two states are Ornstein-Uhlenbeck processes: they drift, and revert to zero over a time constant (days for the slow
one, an hour for the fast one) [Uhlenbeck and Ornstein 1930]. The object's part is constant while the same object is
touched. A tare observes the slow state alone: the fast one, which single electrodes have on their own and by much more
than a resting sensor's noise, is taken for how hand and object lie, as the simulator takes it. (The public recordings have
no tare to decide this. Where tares were observed that do not read it, a filter whose tares read both states kept nothing
of it.) x is the temperature of the finger, its TDC minus the first one of the history, and the slope of each value
over it is estimated with the rest; without TDC that term is left out, to the bit. In the coordinates of a fixed basis in
which all covariances are diagonal, (1) falls apart into D independent filters of four numbers each [Kalman 1960], one for
each of the D values of a touch, so that a reading and a prediction cost the same however many were before.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.files import TensorRecord
from foretouch.types import AnyArray, Float64, Floating, Index
from foretouch.types.channels import Channels

NEW, KNOWN = 0, 1
"""Rows of the arrays that differ between objects out of the training distribution and in it."""

SLOW_TIME_S: Final = 10.0 * 86400.0
FAST_TIME_S: Final = 3600.0
TARE_NOISE: Final = 0.1
"""Variance of a tare over the variance of a grasp, where no tares were recorded: assumed, not measured."""

_ALARM: Final = (10.0, 7.7)
"""Limits of the innovation test without a fit: of the mean square as on the public recordings, whose noise has heavier
tails than a Gaussian (2.0), and of the squared mean at their correlation of .84 within a finger (.84 · 9.14)."""

_RULES: Final[Mapping[str, tuple[str, float, float]]] = {  # letters of the shape, and bounds, which are inclusive
    "basis": ("DD", -1e10, 1e10),
    **dict.fromkeys(("slow", "fast"), ("D", 0.0, 1e6)),
    **dict.fromkeys(("slow_time_s", "fast_time_s"), ("D", 1.0, 1e10)),
    "tare_noise": ("D", 1e-6, 1e3),
    "object": ("2D", 0.0, 1e6),
    "noise": ("2D", 1e-3, 1e3),
    "difference_shrinkage": ("2D", 0.0, 1.0),
    "factor": ("M", 0.1, 100.0),
    "alarm": ("F2", 1e-3, 1e6),
    "slope": ("D", -10.0, 10.0),
    "slope_sd": ("D", 0.0, 10.0),
    "where_scale": ("P", 1e-6, 1e6),
    "where_ratio": ("M", 0.0, 100.0),
}
_TOUCHES: Final = (1, 10, 100, 1000)
_MAX_GAIN: Final = 10.0  # of the largest residual; of a sensor of many values, which add up, 0.2 for each
_MANY: Final = 400  # values: to decompose all their covariances together takes minutes
_MAX_CONDITION: Final = 1e8  # of the basis, its rows scaled to length 1, by the norm of column sums


@dataclass(frozen=True, eq=False)
class TrackerParameters(TensorRecord):
    """Variances, time constants and basis of eq. 1, and of the intervals.

    Variances are in the coordinates of the basis, in units of the noise of a grasp on a new object.
    """

    channels: Channels  # of the readings: D values, M modalities, F fingers
    basis: Float64  # (D, D) [counts]: residual = basis @ coordinates
    slow: Float64  # (D,) variance of the slow state
    slow_time_s: Float64  # (D,) its time constant [s]
    fast: Float64  # (D,) variance of the fast state
    fast_time_s: Float64  # (D,) its time constant [s]
    object: Float64  # (2, D) variance between objects, new and known
    noise: Float64  # (2, D) variance of the noise of a grasp, on new and known objects
    tare_noise: Float64  # (D,) variance of a tare around the slow state
    difference_shrinkage: Float64  # (2, D) in [0, 1], factor on predicted differences between grasps, per value
    factor: Float64  # (M,) by modality: first half width of a 90 % interval over the predicted deviation
    alarm: Float64  # (F, 2) by finger: limits of the two statistics of the innovation test (`models.tracker`)
    slope: Float64  # (D,) expected counts per count of TDC, by value; absent in files of models without
    slope_sd: Float64  # (D,) standard deviation of the slopes between sensors
    where_scale: Float64  # (P,) unit of each feature of a grasp; absent in files of models without
    where_ratio: Float64  # (M,) by modality: variance of what they predict over that of the rest of the noise

    RULES = _RULES

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, AnyArray], **stated: Channels) -> Self:
        """Make the parameters of the arrays of `to_tensors`."""
        none, nowhere = np.zeros(stated["channels"].size), np.zeros(len(stated["channels"].modalities))
        absent = {"slope": none, "slope_sd": none, "where_scale": np.empty(0), "where_ratio": nowhere}
        return super().from_tensors({**absent, **tensors}, **stated)

    @classmethod
    def from_calibration(
        cls,
        channels: Channels,
        between: tuple[Float64, Float64],
        within: tuple[Float64, Float64],
        difference_shrinkage: tuple[Float64, Float64],
        factor: Float64,
    ) -> Self:
        """Return parameters of sensors without drift, from the statistics of residuals.

        After n touches of a new object with mean residual r its offset is then B (B + W/n)⁻¹ r, the multivariate
        empirical Bayes estimate [Efron and Morris 1973].

        The basis diagonalises B and W of new objects at the same time; of B and W of known ones only the diagonals are
        used. Of more than 400 values, modalities are taken for independent of each other. Variances beyond their
        bounds, as of a model without errors, are set to these.

        Args:
            channels: Of the readings.
            between: B of new and of known objects, (D, D) each [counts²].
            within: W of both, (D,) each [counts²].
            difference_shrinkage: Of both, (D,) each.
            factor: (M,) as of the record.
        """
        scale, size = np.sqrt(within[NEW]), channels.size
        basis = np.zeros((size, size))
        objects = np.empty((2, size))
        noise = np.ones((2, size))
        for own in [np.arange(size)] if size <= _MANY else channels.modality_columns.values():
            block = np.ix_(own, own)
            objects[NEW, own], vectors = np.linalg.eigh(between[NEW][block] / np.outer(scale[own], scale[own]))
            basis[block] = scale[own, None] * vectors
            inverse = (vectors / scale[own, None]).T
            objects[KNOWN, own] = np.einsum("ki,ij,kj->k", inverse, between[KNOWN][block], inverse)
            noise[KNOWN, own] = (inverse**2) @ within[KNOWN][own]
        return cls(
            channels=channels,
            basis=basis,
            slow=np.zeros(size),
            slow_time_s=np.full(size, SLOW_TIME_S),
            fast=np.zeros(size),
            fast_time_s=np.full(size, FAST_TIME_S),
            object=np.clip(objects, *_RULES["object"][1:]),
            noise=np.clip(noise, *_RULES["noise"][1:]),
            tare_noise=np.full(size, TARE_NOISE),
            difference_shrinkage=np.array(difference_shrinkage),
            factor=factor,
            alarm=np.tile(_ALARM, (len(channels.fingers), 1)),
            slope=np.zeros(size),
            slope_sd=np.zeros(size),
            where_scale=np.empty(0),
            where_ratio=np.zeros(len(channels.modalities)),
        )

    @property
    def thermal(self) -> bool:
        """Whether readings depend on the temperature."""
        return bool(self.slope.any() or self.slope_sd.any())

    def slopes(self) -> Float64:
        """Return (2, D) mean and variance of the slopes of the coordinates of the basis."""
        inverse = np.linalg.inv(self.basis)
        return np.array([inverse @ self.slope, inverse**2 @ self.slope_sd**2])

    def finger_of(self) -> Index:
        """Return (D,) index of the finger of the values that each coordinate of the basis changes most."""
        return np.asarray(self.channels.finger_of_value[np.argmax(np.abs(self.basis), axis=0)], np.intp)

    def _keeps_fingers_apart(self) -> bool:
        other = self.channels.finger_of_value[:, None] != self.finger_of()
        largest = np.abs(self.basis).max(axis=0)
        return bool((np.abs(self.basis) * other <= 1e-9 * largest).all())

    def _check(self) -> None:
        super()._check()
        length = np.linalg.norm(self.basis, axis=1)
        if not (length > 0.0).all() or not np.linalg.cond(self.basis / length[:, None], 1) < _MAX_CONDITION:
            raise ModelError(f"basis: is singular, or its condition exceeds {_MAX_CONDITION:g}")
        inverse = np.linalg.inv(self.basis)
        if self.thermal and not self._keeps_fingers_apart():
            raise ModelError("slope: the basis mixes values of both fingers, whose temperatures differ")
        self._check_gain(inverse)

    def _check_gain(self, inverse: Floating) -> None:
        """Refuse what turns small residuals into large offsets."""
        limit = max(_MAX_GAIN, 0.2 * self.channels.size)
        modality = self.channels.modality_of_value
        owner = modality[np.argmax(np.abs(self.basis), axis=0)]
        if self.basis[modality[:, None] != owner].any():  # else each modality is on its own, in a fraction of the time
            modality = owner = np.zeros_like(modality)
        parts = [(np.flatnonzero(modality == k), np.flatnonzero(owner == k)) for k in np.unique(modality)]
        for row in (NEW, KNOWN):
            total = self.slow + self.fast + self.object[row]
            for count in _TOUCHES:
                share = total / (total + self.noise[row] / count)
                for own, at in parts:
                    gain = (self.basis[np.ix_(own, at)] * share[at]) @ inverse[np.ix_(at, own)]
                    if not (largest := float(np.abs(gain).sum(axis=1).max())) <= limit:
                        rule = f"{count} touches turn residuals of at most 1 into {largest:.3g}, {limit:g} is allowed"
                        raise ModelError(f"basis, object: {rule}")


class StateFilter:
    """K independent Kalman filters of (1): slow state, fast state, object's part and slope of each coordinate.

    Args:
        prior: (3, K) variances of slow state, fast state and object before any reading.
        times_s: (2, K) time constants of the two states [s].
        slope: (2, K) mean and variance of the slopes over x before any reading; zeros by default.

    Attributes:
        mean: (4, K) of the parts.
        covariance: (4, 4, K) of the parts.
    """

    def __init__(self, prior: Float64, times_s: Float64, slope: Float64 | None = None) -> None:
        slope = np.zeros((2, prior.shape[1])) if slope is None else slope
        self.prior = np.concatenate([prior, slope[1:]])
        self.times_s = times_s
        self._slope = slope[0]
        self.mean = np.zeros_like(self.prior)
        self.covariance = np.zeros((4, *self.prior.shape))
        self.restart(np.arange(prior.shape[1]))

    def copy(self) -> Self:
        """Return an independent filter in the same state."""
        twin = copy.copy(self)
        twin.prior = self.prior.copy()
        twin.mean = self.mean.copy()
        twin.covariance = self.covariance.copy()
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
        """Forget the object's part; the part of the next object has a (K,) prior variance."""
        self.prior[2] = variance
        self.mean[2] = 0.0
        self.covariance[2] = 0.0
        self.covariance[:, 2] = 0.0
        self.covariance[2, 2] = variance

    def restart(self, chosen: np.ndarray, change: Float64 | None = None) -> None:
        """Forget everything about some coordinates.

        Args:
            chosen: Their indices, or a (K,) mask.
            change: (K,) change of the level [counts] that was seen, if any: the slow state may be as far from zero.
        """
        self.mean[:3, chosen] = 0.0
        self.mean[3, chosen] = self._slope[chosen]
        self.covariance[:, :, chosen] = 0.0
        for part in range(4):
            self.covariance[part, part, chosen] = self.prior[part, chosen]
        if change is not None:
            self.covariance[0, 0, chosen] = np.maximum(self.prior[0], change**2)[chosen]

    def predicted(self, parts: int = 3, x: Float64 | None = None) -> tuple[Float64, Float64]:
        """Return (K,) mean and variance of the sum of the parts, with (K,) x also of the slope times x.

        Args:
            parts: 3 of them, or 1: the slow state alone.
            x: (K,) change of the temperature since the first reading [counts]; None leaves the slope out.
        """
        mean, variance = self.mean[:parts].sum(axis=0), self.covariance[:parts, :parts].sum(axis=(0, 1))
        if x is not None:
            mean = mean + self.mean[3] * x
            variance = variance + x * (2.0 * self.covariance[3, :parts].sum(axis=0) + x * self.covariance[3, 3])
        return mean, np.maximum(variance, 0.0)  # after a large jump it may round below

    def observe(self, value: Float64, noise: Float64, parts: int = 3, x: Float64 | None = None) -> None:
        """Add (K,) observations of what `predicted` predicts, with (K,) variances; infinite ones are of no effect."""
        mean, variance = self.predicted(parts, x)
        cross = self.covariance[:, :parts].sum(axis=1)
        if x is not None:
            cross = cross + x * self.covariance[:, 3]
        total = variance + noise
        self.mean += cross * ((value - mean) / total)
        self.covariance -= cross[:, None] * (cross / total)
