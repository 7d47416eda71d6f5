# SPDX-License-Identifier: Apache-2.0
"""Statistics of a model's errors: calibrated prediction intervals, and what the tracker of readings needs.

The residuals of a model on one object have a part that stays for that object and day, of covariance B, and a part that
is new with each grasp, of variance W. Intervals before any reading are conformal with objects as the exchangeable unit:
half widths cover the requested share of residuals, with equal weight for each calibration object
(`learning.training.calibration`). Readings are adapted to by the tracker (`models.tracker`), whose parameters were
fitted to recordings in order of time, or else follow from B and W.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Self

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.files import Rules, TensorRecord, read_part
from foretouch.models.state_space import TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.types import AnyArray, Float64, Touch
from foretouch.types.channels import Channels

GROUPS: Final = ("known", "new")
"""Objects in the training distribution, and out of it."""

_TRACKER: Final = "tracker/"
_MIN_VALUE: Final = 1e-9  # [resolution²] of a variance; rounding alone has 0.08


@dataclass(frozen=True, eq=False)
class CalibrationGroup(TensorRecord):
    """Statistics of the residuals under one condition.

    Attributes:
        channels: Of the readings, D values.
        between: (D, D) float64 [counts²], B: covariance of the part that stays with an object and its day.
        within: (D,) float64 [counts²], W: variance of the part that is new with each grasp, after shrinkage of the
            predicted differences.
        difference_shrinkage: (D,) float64 in [0, 1], shrinkage factor of predicted differences between two grasps on an object.
        spread: (D,) float64 [counts²], variance of the residuals before any touch.
        half_width: (D,) float64 [counts], of the interval before any touch.
    """

    channels: Channels
    between: Float64
    within: Float64
    difference_shrinkage: Float64
    spread: Float64
    half_width: Float64

    def mean_factors(self) -> Float64:
        """Return (M,) half widths over the deviations of the residuals, mean by modality."""
        factor = self.half_width / np.sqrt(self.spread)
        return np.array([factor[own].mean() for own in self.channels.modality_columns.values()])

    def _rules(self) -> Rules:
        most, least = max(1e12, float(self.channels.most.max()) ** 2), _MIN_VALUE * self.channels.resolution.min()
        variance = ("D", least**2 / _MIN_VALUE, most)
        return {
            "between": ("DD", -most, most),
            "within": variance,
            "difference_shrinkage": ("D", 0.0, 1.0),
            "spread": variance,
            "half_width": ("D", least, most),
        }

    def _check(self) -> None:
        super()._check()
        tolerance = 1e-6 * np.abs(self.between).max()
        if np.abs(self.between - self.between.T).max() > tolerance:
            raise ModelError("between: is not symmetric")
        try:  # in a tenth of the time of the eigenvalues, which is minutes of thousands of values
            np.linalg.cholesky(self.between + max(tolerance, 1e-300) * np.eye(len(self.between)))
        except np.linalg.LinAlgError as err:
            raise ModelError("between: is not a covariance: it has a negative eigenvalue") from err


@dataclass(frozen=True, eq=False)
class Calibration:
    """Rest level, adaptation and intervals of one model.

    Attributes:
        channels: Of the readings.
        rest: (D,) float64 [counts]: readings of the training sensors without contact. A tare shifts predictions by its
            difference from it.
        groups: By name from `GROUPS`.
        tracker: Parameters fitted to recordings with stamps; None without such recordings.
    """

    channels: Channels
    rest: Float64
    groups: Mapping[str, CalibrationGroup]
    tracker: TrackerParameters | None = None

    @cached_property
    def tracker_parameters(self) -> TrackerParameters:
        """Return the fitted ones, or else the ones of the groups, by B of known objects split into sensors and objects.

        On an object that the model knows, what stays is of the sensors; what stays beyond it on new ones, of the object.
        The tracker has one factor from deviations to half widths, of known objects. Where the half widths of new ones
        are wider deviations, their B and W are taken as larger.

        Raises:
            ModelError: If B and W amplify residuals, or are out of any range.
        """
        if self.tracker is not None:
            return self.tracker
        new, known = self.groups["new"], self.groups["known"]
        factor, new_factor = known.mean_factors(), new.mean_factors()
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused below
                wider = self.channels.by_modality(new_factor / factor)
                parameters = TrackerParameters.from_calibration(
                    self.channels,
                    (new.between * np.outer(wider, wider), known.between),
                    (new.within * wider**2, known.within),
                    (new.difference_shrinkage, known.difference_shrinkage),
                    factor,
                )
            sensors = parameters.object.min(axis=0)
            parameters = replace(parameters, slow=sensors, object=parameters.object - sensors)
            return TrackerParameters.from_tensors(parameters.to_tensors(), channels=self.channels)
        except (ModelError, np.linalg.LinAlgError) as err:
            raise ModelError(f"between, within: no tracker can be made of them: {err}") from err

    def contact_signs(self, tare: Touch) -> tuple[str, ...]:
        """Return why a reading may be one in contact and thus no tare, a line each; empty for one at rest.

        Contact moves values to the side that the sensor's description states: PDC up, electrodes down. The rule is three deviations of
        the drift that the tracker expects, of a scalar such as PDC or of three taxels. It is for the fingers of the training data: the
        rest of others may be elsewhere. Of the 400 grasps of vision2tactile it finds 99 %; what drifts as the tracker expects is found
        in less than 1 %.
        """
        tracker = self.tracker_parameters
        deviation = np.sqrt(tracker.basis**2 @ (tracker.slow + tracker.fast + tracker.tare_noise))
        offset, signs = tare_offset(tare, self.rest), []
        for name, channel in self.channels.channel_of.items():
            where, side = self.channels.columns([name]), ("far from", "far above", "far below")[channel.contact]
            moved = offset[where] * channel.contact if channel.contact else np.abs(offset[where])
            count = np.count_nonzero(moved > 3.0 * deviation[where])
            if channel.size == 1 and count:
                k = where[0]
                read, rest, spread = map(channel.text, (tare.values[k], self.rest[k], deviation[k]))
                signs.append(f"{name}: {read} is {side} the rest level, {rest} ± {spread}")
            elif count >= 3:
                signs.append(f"{name}: {count} values are {side} their rest level")
        return tuple(signs)

    @cached_property
    def unread_half_widths(self) -> Mapping[str, Float64]:
        """(D,) half widths before any reading, by group [counts]."""
        if self.tracker is None:
            return {name: group.half_width for name, group in self.groups.items()}
        tracker = SensorTracker(self.tracker)
        levels = {name: tracker.level(0, same_object=False, known=name == "known") for name in GROUPS}
        return {name: tracker.adapt(level, np.zeros((1, self.channels.size)))[1][0] for name, level in levels.items()}

    def to_tensors(self) -> dict[str, AnyArray]:
        """Arrays by name, for a file."""
        tensors: dict[str, AnyArray] = {"rest": self.rest}
        for name, group in self.groups.items():
            tensors |= {f"{name}/{field}": array for field, array in group.to_tensors().items()}
        if self.tracker is not None:
            tensors |= {_TRACKER + field: array for field, array in self.tracker.to_tensors().items()}
        return tensors

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, AnyArray], channels: Channels) -> Self:
        """Make a calibration of the arrays of `to_tensors`, for a model of these channels.

        Raises:
            ModelError: Names the array that is missing, of another shape or not finite, or no variance, width,
                shrinkage factor or covariance.
        """
        tensors = {name: np.asarray(array, np.float64) for name, array in tensors.items()}
        if "rest" not in tensors or tensors["rest"].shape != (channels.size,) or not np.isfinite(tensors["rest"]).all():
            raise ModelError(f"rest: is missing, of another shape than ({channels.size},), or not finite")
        tracked = any(name.startswith(_TRACKER) for name in tensors)
        calibration = cls(
            channels,
            tensors["rest"],
            {name: read_part(CalibrationGroup, tensors, f"{name}/", channels=channels) for name in GROUPS},
            read_part(TrackerParameters, tensors, _TRACKER, channels=channels) if tracked else None,
        )
        _ = calibration.tracker_parameters  # refuses groups of which none can be made
        return calibration


def tare_offset(tare: Touch, rest: Float64) -> Float64:
    """Return (D,) a tare minus a rest level; 0 of channels that are not tared."""
    return np.where(tare.channels.tared, tare.values - rest, 0.0)
