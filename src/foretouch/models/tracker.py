# SPDX-License-Identifier: Apache-2.0
"""Tracking of a sensor's state over readings of many objects, with intervals that stay calibrated while it drifts.

    tare ────────────► state ◄──┐
    touch - vision ──► state + object ──► level ± deviation ──► prediction ± factor · deviation
                                                                    factor ◄── did the interval contain the reading?

Half widths are the predicted deviation times one factor per modality. Each touch adapts the factor by adaptive
conformal inference [Gibbs and Candès 2021], as quantile tracking [Angelopoulos, Candès and Tibshirani 2023] of the
logarithm: log factor += rate · (share of values outside - 0.1). Over many touches the share outside tends to 10 %,
whatever the sensors do, as long as the factor stays within its limits. What was adapted is partly of the object: at
another object, the logarithm goes half of the way back to its first value.

Innovation test. For each finger, of the innovations of its values in units of their predicted deviations, the mean
square (a wrong pattern) and the squared mean (a common jump) are compared with limits: scaled chi-square variables for
Gaussian noise; since recorded noise has heavier tails, each limit is above in one of 100 recorded touches. A touch that
fails is not used. If the next one fails as well, the finger was exchanged or jumped: it is named, and all that was
learned about it is forgotten. If touches were independent, a finger without fault would be restarted once in 2500 of
them at most. They are not: of twelve simulated campaigns of 192 touches, one finger was restarted in four. The first
touch of an object has limits four times as high, since there a jump cannot be separated from an unusual object. A tare,
which is the median of many readings, restarts a finger at once; its limit of the squared mean is that of one standard
Gaussian variable at least, since what drifts may be common to all values of a finger.

Temperature. Electrodes follow the temperature of their finger, which TDC measures. Where the parameters have slopes, a
reading with TDC is explained by its difference from the first TDC of the history, too; a prediction takes the latest
one. TDC that is absent, zero or saturated is left out, finger by finger. A jump that no finger's temperature makes, as
after a power cycle, moves the reference.
"""

import copy
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from foretouch.errors import ModelError, TactileError, require_type, shown
from foretouch.models.files import packed
from foretouch.models.similar_touches import MOST, SimilarTouches
from foretouch.models.state_space import KNOWN, NEW, StateFilter, TrackerParameters
from foretouch.tactile import is_tdc
from foretouch.types import AnyArray, Bool, Evidence, Float64, UInt8
from foretouch.types.channels import Channels

MISS_RATE: Final = 0.1
"""Share of readings outside the intervals."""

_ADAPTATION_RATE: Final = 0.2  # of the logarithm of the factor, a touch
_COMMON_JUMP: Final = 9.14  # quantile 0.9975 of chi-square with 1 degree of freedom
_KEPT_SHARE: Final = 0.5  # of what was adapted, at another object
_FIRST_TOUCH: Final = 4.0  # times the limits at the first touch: few objects determine how much objects differ
_FACTOR_RANGE: Final = math.log(8.0)  # the factor is at most 8 times its first value, and at least an eighth of it
_LATE_NS: Final = 60 * 10**9  # readings of several topics arrive in this order at most
_AHEAD_NS: Final = 60 * 10**9
_TDC_JUMP: Final = (150.0, 2.0, 800.0)  # at once, in each second, and at most; recorded: 71 in 95 s, 385 in a day
_MOST_MEAN: Final = 4.0  # times the largest level
_ROUNDING: Final = 1e-15  # of a covariance, relative to the largest one before
_MOST_SLOPE: Final = 1e4  # in the coordinates of the basis
_NO_STAMP: Final = "not nanoseconds from 0"


def checked_stamp(stamp_ns: Any) -> int:
    """Return a stamp [ns]; a `TactileError` if it is not a whole number from 0."""
    if isinstance(stamp_ns, bool) or not isinstance(stamp_ns, int | np.integer) or not 0 <= stamp_ns < 2**63:
        raise TactileError(f"stamp: {shown(stamp_ns, 60)} is {_NO_STAMP}")
    return int(stamp_ns)


@dataclass(frozen=True, eq=False)
class Level:
    """What readings differ by from predictions by vision, at one time."""

    offset: Float64  # (D,) [counts]
    thermal: Float64  # (D,) the part of the offset that follows from the temperature [counts]
    variance: Float64  # (D,) of the offset, without the noise of a grasp [counts²]
    same_object: bool  # whether it is for the current object
    similar: bool  # whether places on the object are compared with its earlier touches
    kind: int  # of the object, KNOWN or NEW
    evidence: Evidence  # readings behind it


class SensorTracker:
    """State of the sensors of a hand, and offset of the object that is touched; not for several threads at once.

    Every method that adds a reading takes its stamp on the wall clock, which goes on while the robot is off. Stamps may
    be up to 60 s out of order. Readings and predictions are vectors as of `Touch.values`; predictions are those by
    vision, without a shift by a tare.

    Args:
        parameters: Of the model that predicts by vision.

    Attributes:
        touches: Number of touches of the current object.
        revision: Changes whenever a reading is added or an object begins.
        similar: Touches of the current object by where it was touched.
        tdc_readings: Readings with the temperature of a finger at least.
        tdc_jumps: How often the temperature of a finger jumped, as after a power cycle.
    """

    def __init__(self, parameters: TrackerParameters) -> None:
        self.parameters = parameters
        self._channels = parameters.channels
        self._inverse = np.linalg.inv(parameters.basis)
        self._squared = parameters.basis**2
        largest = np.abs(parameters.basis).max(axis=1)
        used = np.abs(parameters.basis) > 1e-9 * largest[:, None]
        self._coordinates = [used[values].any(axis=0) for values in self._channels.finger_columns.values()]
        prior = np.array([parameters.slow, parameters.fast, parameters.object[NEW]])
        times_s = np.array([parameters.slow_time_s, parameters.fast_time_s])
        self._filter = StateFilter(prior, times_s, parameters.slopes() if parameters.thermal else None)
        self._finger = parameters.finger_of()
        self._tdc = np.full((2, len(self._channels.fingers)), np.nan)  # reference and latest, as far as one was read
        self._tdc_ns = -1
        self.tdc_readings = self.tdc_jumps = 0
        self._kind = NEW
        self._suspect = np.zeros(len(self._channels.fingers), np.bool_)
        self._first_log_factor = self._log_factor = np.log(parameters.factor)
        self._expected = np.zeros(self._channels.size)  # sum over the touches of the object
        self.similar = SimilarTouches.none(parameters)
        self.touches = self._readings = 0
        self._newest_ns = self._object_ns = -1
        self.revision = 0

    def copy(self) -> Self:
        """Return an independent tracker in the same state."""
        twin = copy.copy(self)
        twin._filter = self._filter.copy()  # noqa: SLF001  its own class
        return twin

    def keep_to_clock(self, now_ns: int) -> bool:
        """Count readings as taken now whose stamps are more than 60 s ahead of a clock [ns], which was wrong then or set back.

        Returns whether there are any. 0 stands for a clock that was not read yet.
        """
        require_type(now_ns, int | np.integer, "clock", _NO_STAMP, TactileError)
        if now_ns <= 0 or self._newest_ns - now_ns <= _AHEAD_NS:
            return False
        self._newest_ns, self._object_ns, self._tdc_ns = (
            min(stamp_ns, now_ns) for stamp_ns in (self._newest_ns, self._object_ns, self._tdc_ns)
        )
        return True

    def add_tare(self, stamp_ns: int, offset: Float64, *, tdc: Float64 | None = None) -> tuple[str, ...]:
        """Add a tare.

        Args:
            stamp_ns: When it was taken [ns].
            offset: (D,) tare minus rest level of the model [counts]; NaN of taxels that were not read.
            tdc: (F,) TDC of the fingers [counts]; NaN or None where it was not read.

        Returns:
            Names of the fingers that the innovation test restarted.

        Raises:
            TactileError: If the stamp or a value cannot be used; nothing is changed then.
        """
        self._check("tare", offset)
        stamp = self._checked_stamp(stamp_ns)
        self._filter.advance(self._seconds_to(stamp))
        x = self._add_tdc(tdc, stamp)
        mean, variance = self._filter.predicted(parts=1, x=x)
        variance = variance + self.parameters.tare_noise
        limits = np.maximum(self.parameters.alarm, [0.0, _COMMON_JUMP])
        innovation = self._completed(offset - self.parameters.basis @ mean, variance)
        failed = self._failed(innovation, variance, limits)
        level = self._inverse @ (self.parameters.basis @ mean + innovation)
        self._restart(failed, level)
        self._filter.observe(level, self.parameters.tare_noise, parts=1, x=x)
        self._newest_ns, self._readings = stamp, self._readings + 1
        self.revision += 1
        return self._names(failed)

    def add_touch(
        self,
        stamp_ns: int,
        reading: Float64,
        expected: Float64,
        *,
        tdc: Float64 | None = None,
        where: Float64 | None = None,
    ) -> tuple[str, ...]:
        """Add the (D,) reading of a grasp on the current object, and the prediction by vision of this grasp [counts].

        The reading is NaN at taxels that were not read. `where` are the (P,) features of the grasp. The other arguments, the result and the errors are as of `add_tare`.
        """
        self._check("reading", reading, working=True)
        self._check("expected", expected)
        stamp = self._checked_stamp(stamp_ns)
        self._filter.advance(self._seconds_to(stamp))
        self._newest_ns = stamp
        x = self._add_tdc(tdc, stamp)
        level = self.level(stamp)
        counts, half = self.adapt(level, expected[None], None if where is None else where[None])
        outside = np.abs(reading - counts[0]) > half[0]
        self._adapt_factor(np.where(np.isnan(reading), MISS_RATE, outside))
        mean, variance = self._filter.predicted(x=x)
        noise = self.parameters.noise[self._kind]
        limits = self.parameters.alarm * (1.0 if self.touches else _FIRST_TOUCH)
        innovation = self._completed(reading - expected - self.parameters.basis @ mean, variance + noise)
        reading = expected + self.parameters.basis @ mean + innovation
        failed = self._failed(innovation, variance + noise, limits)
        restarted = failed & self._suspect
        observed = self._inverse @ (reading - expected)
        self._restart(restarted, observed)
        self._suspect = failed & ~restarted
        noise = np.where(self._coordinates_of(self._suspect), np.inf, noise)
        self._filter.observe(observed, noise, x=x)
        if where is not None and self.parameters.where_ratio.any() and not failed.any():
            seen = self.parameters.difference_shrinkage[self._kind] * expected + level.thermal
            self.similar = self.similar.added(where, reading - seen)
        self._expected = self._expected + expected
        self._object_ns = stamp
        self._readings, self.touches = self._readings + 1, self.touches + 1
        self.revision += 1
        return self._names(restarted)

    def start_object(self, *, known: bool = False) -> None:
        """Another object: forget the object's part, keep the state.

        Args:
            known: Whether the object is in the distribution of the training data.
        """
        self._kind = KNOWN if known else NEW
        self._filter.start_object(self.parameters.object[self._kind])
        self._log_factor = self._other_log_factor()
        self._expected = np.zeros(self._channels.size)
        self.similar = SimilarTouches.none(self.parameters)
        self.touches, self._object_ns = 0, -1
        self.revision += 1

    def level(
        self, stamp_ns: int, *, same_object: bool = True, known: bool = False, tdc: Float64 | None = None
    ) -> Level:
        """Offset of readings from predictions by vision at a time; a stamp before the newest reading counts as that.

        Args:
            stamp_ns: Time of the prediction [ns].
            same_object: Whether it is for the current object, else for one that was not touched.
            known: Of another object, as of `start_object`.
            tdc: (F,) TDC at that time [counts]; where it is not known, the latest one counts.
        """
        kind = self._kind
        at = self._filter.copy()
        at.advance(self._seconds_to(stamp_ns))
        if not same_object:
            kind = KNOWN if known else NEW
            at.start_object(self.parameters.object[kind])
        x = self._change(self._followed(tdc, stamp_ns)[0])
        mean, variance = at.predicted(x=x)
        return Level(
            offset=np.asarray(self.parameters.basis @ mean, np.float64),
            thermal=np.asarray(self.parameters.basis @ (at.mean[3] * (0.0 if x is None else x)), np.float64),
            variance=np.asarray(self._squared @ np.maximum(variance, 0.0), np.float64),
            same_object=same_object,
            similar=same_object and self.similar.enough,
            kind=kind,
            evidence=self.evidence(stamp_ns, same_object=same_object),
        )

    def _followed(self, tdc: Float64 | None, stamp_ns: int) -> tuple[Float64, int]:
        """Return (2, F) reference and latest TDC by finger after a reading of it, NaN without any, and how many jumped."""
        reference, before = self._tdc
        if tdc is None or not self.parameters.thermal:
            return self._tdc, 0
        latest = np.where(is_tdc(tdc), tdc, before)
        at_once, each_second, most = _TDC_JUMP
        limit = min(most, at_once + each_second * max(0, stamp_ns - self._tdc_ns) / 1e9)
        jumped = np.abs(latest - before) > limit  # not where there was none before
        reference = np.where(jumped, reference + latest - before, np.where(np.isnan(reference), latest, reference))
        return np.stack([reference, latest]), int(jumped.sum())

    def _change(self, tdc: Float64) -> Float64 | None:
        """Return (D,) latest TDC minus reference, of each coordinate's finger; None where there is none."""
        if np.isnan(tdc).all():
            return None
        return np.asarray(np.nan_to_num(tdc[1] - tdc[0])[self._finger], np.float64)

    def _add_tdc(self, tdc: Float64 | None, stamp_ns: int) -> Float64 | None:
        """Take note of the temperature of a reading, and give it as `_change`."""
        if tdc is not None and self.parameters.thermal and is_tdc(tdc).any():
            self._tdc, jumped = self._followed(tdc, stamp_ns)
            self._tdc_ns = stamp_ns
            self.tdc_readings += 1
            self.tdc_jumps += jumped
        return self._change(self._tdc)

    def evidence(self, stamp_ns: int, *, same_object: bool = True) -> Evidence:
        """Return numbers and ages of the readings behind a level; arguments as of `level`."""
        touches = self.touches if same_object else 0
        return Evidence(
            touches=touches,
            touch_age_s=max(0, int(stamp_ns) - self._object_ns) / 1e9 if touches else None,
            readings=self._readings,
            reading_age_s=self._seconds_to(stamp_ns) if self._readings else None,
        )

    def adapt(self, level: Level, expected: Float64, where: Float64 | None = None) -> tuple[Float64, Float64]:
        """Return (K, D) predictions adapted to all readings, and (K, D) half widths of their 90 % intervals [counts].

        After touches of the object, differences of the predictions by vision from their mean at the touches are
        multiplied by `difference_shrinkage`, and touches at similar places take part.

        Args:
            level: Of this tracker since its last reading.
            expected: (K, D) predictions by vision [counts].
            where: (K, P) features of the grasps; None leaves out where the object was touched.
        """
        counts, variance = self.moments(level, expected, where)
        return counts, self.factor(level) * np.sqrt(variance)

    def moments(self, level: Level, expected: Float64, where: Float64 | None = None) -> tuple[Float64, Float64]:
        """Return (K, D) means [counts] and variances [counts²] of readings, without the factor of the intervals; see `adapt`."""
        counts, noise = expected + level.offset, self._squared @ self.parameters.noise[level.kind]
        if level.evidence.touches:
            shrinkage = self.parameters.difference_shrinkage[level.kind]
            anchor = self._expected / level.evidence.touches
            counts = anchor + shrinkage * (expected - anchor) + level.offset
            if where is not None and level.similar:
                base = (1.0 - shrinkage) * anchor + level.offset - level.thermal
                change, share = self.similar.regress(where, base)
                counts, noise = counts + change, noise * share[:, self._channels.modality_of_value]
        return counts, np.broadcast_to(level.variance + noise, counts.shape)

    def factor(self, level: Level) -> Float64:
        """Return (D,) half widths of the intervals over the deviations."""
        logarithm = self._log_factor if level.same_object else self._other_log_factor()
        return np.asarray(self._channels.by_modality(np.exp(logarithm)), np.float64)

    def _completed(self, innovation: Float64, variance: Float64) -> Float64:
        """Return (D,) innovations, with their mean given the others where they are NaN; the variance is (D,) in coordinates.

        The mean of the state after them is then that after the others alone.
        """
        unread = np.isnan(innovation)
        if not unread.any():
            return innovation
        precision = (self._inverse[:, unread] / variance[:, None]).T @ self._inverse  # rows of that of the innovations
        completed = innovation.copy()
        completed[unread] = -np.linalg.solve(precision[:, unread], precision[:, ~unread] @ innovation[~unread])
        return completed

    def _adapt_factor(self, outside: Float64) -> None:
        """Widen or narrow the intervals by whether the last ones contained the reading."""
        moved = self._log_factor + _ADAPTATION_RATE * (self._channels.modality_means @ outside - MISS_RATE)
        self._log_factor = np.minimum(
            np.maximum(moved, self._first_log_factor - _FACTOR_RANGE), self._first_log_factor + _FACTOR_RANGE
        )

    def _other_log_factor(self) -> Float64:
        """Return (M,) logarithm of the factor for another object."""
        return self._first_log_factor + _KEPT_SHARE * (self._log_factor - self._first_log_factor)

    def _failed(self, innovation: Float64, variance: Float64, limits: Float64) -> Bool:
        """Return (F,) whether each finger fails the test, from (D,) innovations [counts] and variances in coordinates."""
        statistics = innovation_statistics(innovation / np.sqrt(self._squared @ variance), self._channels)
        return np.asarray((statistics > limits).any(axis=1), np.bool_)

    def _coordinates_of(self, fingers: Bool) -> Bool:
        """Return (D,) which coordinates the chosen fingers' values depend on."""
        chosen = np.zeros(self._channels.size, np.bool_)
        for own, finger in zip(self._coordinates, fingers, strict=True):
            if finger:
                chosen |= own
        return chosen

    def _names(self, fingers: Bool) -> tuple[str, ...]:
        return tuple(name for name, finger in zip(self._channels.fingers, fingers, strict=True) if finger)

    def _restart(self, fingers: Bool, level: Float64) -> None:
        """Forget the state of some fingers, whose level is now far from the expected one; (D,) in coordinates."""
        if fingers.any():
            self._filter.restart(self._coordinates_of(fingers), level)
            self.similar = SimilarTouches.none(self.parameters)
            self._suspect = self._suspect & ~fingers

    def _check(self, name: str, values: Float64, *, working: bool = False) -> None:
        """Refuse values that are not finite, or that neither a reading of a working sensor nor a prediction can be."""
        channels = self._channels
        if values.shape != (channels.size,):
            raise TactileError(f"{name}: shape {values.shape} is not ({channels.size},)")
        low, high = (channels.low, channels.high) if working else (-channels.most, channels.most)
        unread = np.isnan(values) & channels.of_taxels & (name != "expected")
        parts = channels.modality_columns.values()  # counted, since a sum of shares may round to either side of a half
        unread &= channels.by_modality([2 * np.count_nonzero(unread[part]) < len(part) for part in parts])
        wrong = np.flatnonzero(~((values >= low) & (values <= high)) & ~unread)  # NaN fails too
        if wrong.size:
            k = int(wrong[0])
            unit = channels.channel_of[channels.modalities[channels.modality_of_value[k]]].unit
            raise TactileError(f"{name}: value {k}: {values[k]:g} is not within [{low[k]:g}, {high[k]:g}] {unit}")

    def _seconds_to(self, stamp_ns: int) -> float:
        return max(0, int(stamp_ns) - self._newest_ns) / 1e9 if self._newest_ns >= 0 else 0.0

    def _checked_stamp(self, stamp_ns: int) -> int:
        """Return the stamp, not before the newest one; a `TactileError` if it is not a valid stamp, or too late."""
        stamp = checked_stamp(stamp_ns)
        if self._newest_ns >= 0 and self._newest_ns - stamp > _LATE_NS:
            late = (self._newest_ns - stamp) / 1e9
            raise TactileError(f"stamp: is {late:.1f} s before that of the newest reading, 60 s are allowed")
        return max(stamp, self._newest_ns)

    def to_tensors(self) -> dict[str, AnyArray]:
        """Return all that is known, for a file; a tracker made from it continues to the bit as this one."""
        flags = [self.touches, self._readings, self._kind, *self._suspect]
        optional = {} if np.isnan(self._tdc).all() else self._thermal_tensors()
        if len(self.similar.where):
            optional |= {"where": self.similar.where, "where_readings": self.similar.readings}
        return optional | {
            "mean": self._filter.mean[:3].copy(),
            "covariance": self._filter.covariance[:3, :3].copy(),
            "expected": self._expected,
            "log_factor": self._log_factor,
            "counts": np.array(flags, np.int64),
            "stamps_ns": np.array([self._newest_ns, self._object_ns], np.int64),
            "parameters": _digest(self.parameters),
        }

    def _thermal_tensors(self) -> dict[str, AnyArray]:
        """Return what TDC said, which files of histories without it lack."""
        return {
            "slope": np.concatenate([self._filter.mean[3:], self._filter.covariance[3]]),
            "tdc": np.nan_to_num(self._tdc),  # 0 where none was read
            "tdc_counts": np.array([self._tdc_ns, self.tdc_readings, self.tdc_jumps], np.int64),
        }

    @classmethod
    def from_tensors(cls, parameters: TrackerParameters, tensors: Mapping[str, AnyArray]) -> Self:
        """Make the object of the arrays of `to_tensors`.

        Raises:
            ModelError: Names the array that is missing, of another shape or type or not possible, or `parameters` if it
                is the state of another model.
        """
        tracker = cls(parameters)
        thermal = tracker._thermal_tensors() if "tdc" in tensors else {}
        for name, own in {**tracker.to_tensors(), **thermal}.items():
            array = tensors.get(name)
            if array is None:
                raise ModelError(f"{name}: is missing")
            if array.shape != own.shape or array.dtype != own.dtype:
                raise ModelError(f"{name}: {array.dtype} {array.shape} is not {own.dtype} {own.shape}")
            if not np.isfinite(array).all():
                raise ModelError(f"{name}: holds a value that is not finite")
        if (tensors["parameters"] != _digest(parameters)).any():
            raise ModelError("parameters: are those of another model")
        tracker._restore(tensors)
        if "where" in tensors:
            tracker.similar = _similar(parameters, tracker.touches, tensors)
        return tracker

    def _largest_level(self) -> Float64:
        """Return (D,) how far from zero readings can be from predictions, in the coordinates of the basis."""
        return np.asarray(np.abs(self._inverse) @ (2.0 * self._channels.most), np.float64)

    def _restore(self, tensors: Mapping[str, AnyArray]) -> None:
        touches, readings, kind, *suspect = (int(value) for value in tensors["counts"])
        newest, last_of_object = (int(value) for value in tensors["stamps_ns"])
        possible = (
            0 <= touches <= readings
            and {kind, *suspect} <= {0, 1}
            and -1 <= last_of_object <= newest
            and (newest < 0) == (readings == 0)
            and (np.abs(tensors["log_factor"] - self._first_log_factor) <= _FACTOR_RANGE + 1e-9).all()
            and (np.abs(tensors["expected"]) <= self._channels.most * max(touches, 1)).all()
            and (np.abs(tensors["mean"]) <= _MOST_MEAN * (largest := self._largest_level())).all()
        )
        if not possible:
            raise ModelError("counts, stamps_ns, log_factor, expected, mean: hold what readings cannot give")
        self._kind = kind
        self._filter.start_object(self.parameters.object[kind])
        mean, covariance = self._filter.mean.copy(), self._filter.covariance.copy()
        mean[:3], covariance[:3, :3] = tensors["mean"], tensors["covariance"]
        if "tdc" in tensors:
            mean[3] = tensors["slope"][0]
            covariance[3] = tensors["slope"][1:]
            covariance[:, 3] = tensors["slope"][1:]
            tdc = tensors["tdc"]
            self._tdc_ns, self.tdc_readings, self.tdc_jumps = (int(value) for value in tensors["tdc_counts"])
            if not (is_tdc(tdc[1]) | (tdc[1] == 0.0)).all() or np.abs(mean[3]).max() > _MOST_SLOPE:
                raise ModelError("slope, tdc: hold values that readings cannot give")
            self._tdc = np.where(tdc[1] == 0.0, np.nan, tdc)
        _check_covariance(covariance, self._filter.prior, largest)
        self._filter.mean[:], self._filter.covariance[:] = mean, covariance
        self._expected = tensors["expected"].astype(np.float64)
        self._log_factor = tensors["log_factor"].astype(np.float64)
        self.touches = touches
        self._readings = readings
        self._suspect = np.array(suspect, np.bool_)
        self._newest_ns, self._object_ns = newest, last_of_object


def _check_covariance(covariance: Float64, prior: Float64, largest: Float64) -> None:
    """Refuse (4, 4, K) covariances that readings cannot give, with a `ModelError`.

    After a jump, the slow state is as uncertain as the jump was large (`StateFilter.restart`); no other part is ever less certain than
    before any reading. Covariances that have followed a large jump are exact to its square times the rounding of a float64.
    """
    variances = np.einsum("iik->ik", covariance)
    limit = prior.copy()
    limit[0] = np.maximum(limit[0], largest**2)
    rounding = 1e-9 + _ROUNDING * largest**2
    bound = np.sqrt(np.abs(variances[:, None] * variances)) * (1.0 + 1e-6) + rounding
    fits = (variances >= -rounding) & (variances <= limit * (1.0 + 1e-6) + rounding)
    if not fits.all() or (np.abs(covariance) > bound).any():
        raise ModelError("covariance: is none that the parameters allow")


def innovation_statistics(standard: Float64, channels: Channels) -> Float64:
    """Return (F, 2) by finger: mean square and squared mean of the (D,) innovations in units of their deviations."""
    means = channels.finger_means
    return np.stack([means @ standard**2, (means @ standard) ** 2], axis=1)


def _similar(parameters: TrackerParameters, touches: int, tensors: Mapping[str, AnyArray]) -> SimilarTouches:
    """Touches by where they were, from a file; a `ModelError` if the touches of the object cannot have been these."""
    where, readings = tensors["where"], tensors.get("where_readings", np.empty(0))
    shapes = (len(where), parameters.where_scale.size), (len(where), parameters.channels.size)
    fits = (where.shape, readings.shape) == shapes and len(where) <= min(touches, MOST)
    if not fits or not np.isfinite(where).all() or not (np.abs(readings) <= 4.0 * parameters.channels.most).all():
        raise ModelError("where, where_readings: hold what touches of the object cannot give")
    return SimilarTouches(parameters, where.astype(np.float64), readings.astype(np.float64))


def _digest(parameters: TrackerParameters) -> UInt8:
    """Hash all but the slopes and units of features, which a state without TDC or features does not depend on."""
    tensors = parameters.to_tensors()
    for name in ("slope", "slope_sd", "where_scale", "where_ratio"):
        del tensors[name]
    return np.frombuffer(hashlib.sha256(packed(tensors)[0]).digest(), np.uint8)
