# SPDX-License-Identifier: Apache-2.0
"""Prediction of touch: one cloud and K grasps in, K predictions out, with an interval, a reference and flags.

cloud, K grasps ─ estimator ─► counts ─ adapted to earlier readings ─► value ± half width, flags

Earlier readings are a tare, touches of the same object, or the history of a hand with many objects. A calibration with
the parameters of a tracker (`models.tracker`) adapts to all of them by it; one without, such as that of contact-v1, to
a tare and to touches of one object in closed form (`models.calibration`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits, check_object
from foretouch.errors import GraspError, ModelError, TactileError
from foretouch.grasp.pose import check_rotation, surely_rotations
from foretouch.grasp.reach import DEFAULT_REACH, ReachConfig, check_reach, surely_in_reach
from foretouch.models.calibration import Calibration
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import TactileRanges, check_touch
from foretouch.types import (
    TOUCH_SIZE,
    Cloud,
    Evidence,
    Float64,
    Grasp,
    GraspList,
    Reference,
    Touch,
    TouchPrediction,
    TouchPredictions,
    stacked,
)

_EXECUTED_WIDTH_M = 2.0  # more than the span of any hand
_FLAGS = {
    (outside, known): ("out_of_range",) * outside + ("unfamiliar",) * (not known)
    for outside in (False, True)
    for known in (False, True)
}


@dataclass(frozen=True, eq=False)
class Estimate:
    """Predictions for K grasps on one cloud, before tare, touches and intervals are applied."""

    counts: Float64  # (K, 50) float64 [counts]
    in_distribution: npt.NDArray[np.bool_]  # (K,) bool: whether cloud and grasp resemble those of training


@dataclass(frozen=True, eq=False)
class _Adapted:
    """Predictions for K grasps after readings."""

    counts: Float64  # (K, 50) float64 [counts]
    half: Float64  # (K, 50) float64, half widths of the intervals; NaN without a calibration [counts]
    reference: Reference
    evidence: Evidence


@dataclass(frozen=True, eq=False)
class History:
    """Readings of one hand up to a time, for predictions at that time."""

    tracker: SensorTracker  # of the model's calibration
    stamp_ns: int  # time of the predictions [ns]
    same_object: bool = True  # whether they are for the object that was touched last
    tare: bool = False  # whether a tare was taken shortly before

    def adapt(self, estimate: Estimate) -> _Adapted:
        """Predictions by sight, adapted to the readings."""
        counts, half = estimate.counts.copy(), np.empty_like(estimate.counts)
        same = self.same_object and self.tracker.touches > 0
        for inside in (False, True):
            rows = estimate.in_distribution == inside
            if rows.any():
                level = self.tracker.level(self.stamp_ns, same_object=same, known=inside)
                counts[rows], half[rows] = self.tracker.adapt(level, estimate.counts[rows])
        evidence = self.tracker.evidence(self.stamp_ns, same_object=same)
        reference: Reference = (
            "touches" if same else "tare" if self.tare else "history" if evidence.readings else "none"
        )
        return _Adapted(counts, half, reference, evidence)


class Estimator(Protocol):
    """Predicts touch from the cloud and the grasp alone; what the kinds of touch models implement."""

    @property
    def ranges(self) -> TactileRanges:
        """Ranges outside which a predicted value is flagged."""
        ...

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """Predict K grasps; the cloud's features are computed once.

        Raises:
            CloudError: If the cloud holds too few points or all at one position.
            ModelError: If it lacks a channel that the model needs.
        """
        ...


class TouchModel:
    """An estimator with its card and its calibration; immutable, so threads may share it.

    Args:
        estimator: Predicts from the cloud and the grasp alone.
        card: The card of the model.
        calibration: Rest level, adaptation and intervals; None if the card holds no calibration.
        widen: (50,) factors of the half widths of the intervals; 1 by default.

    Attributes:
        name, sha256: From the card; the hash is of the weights, or over those of all members.
        ranges: Ranges outside which a predicted value is flagged.
    """

    def __init__(
        self,
        estimator: Estimator,
        card: Mapping[str, Any],
        calibration: Calibration | None = None,
        widen: Float64 | None = None,
    ) -> None:
        self.name: str = card["name"]
        self.sha256: str = card["sha256"]
        self.card = dict(card)
        self.calibration = calibration
        self.ranges = estimator.ranges
        self._estimator = estimator
        self._widen = widen
        parameters = None if calibration is None else calibration.tracker
        self._unread = None if parameters is None else SensorTracker(parameters)

    def reduced(self, estimator: Estimator, widen: Float64) -> TouchModel:
        """The same model, which estimates in a cheaper way.

        Args:
            estimator: With the rest level and the readings of this model.
            widen: (50,) factors of the half widths of its intervals.
        """
        return TouchModel(estimator, self.card, self.calibration, widen)

    @property
    def estimator(self) -> Estimator:
        """Predicts from the cloud and the grasp alone."""
        return self._estimator

    @property
    def tracks(self) -> bool:
        """Whether its calibration has the parameters of a tracker, so that predictions may adapt to a `history`."""
        return self._unread is not None

    def new_tracker(self) -> SensorTracker:
        """A tracker of a hand whose readings are compared with this model's predictions.

        Raises:
            ModelError: If the calibration has no parameters of a tracker.
        """
        if self._unread is None:
            raise ModelError(f"{self.name}: history: cannot be used: its calibration does not model the sensors' drift")
        return self._unread.copy()

    def predict(
        self,
        cloud: Cloud,
        grasps: Sequence[Grasp],
        *,
        tare: Touch | None = None,
        residuals: ObjectResiduals | None = None,
        history: History | None = None,
        limits: ObjectLimits = DEFAULT_LIMITS,
        reach: ReachConfig = DEFAULT_REACH,
    ) -> Sequence[TouchPrediction]:
        """Predict the readings of both fingertips at each grasp.

        Predictions are deterministic, and independent of the other grasps of the call to the last bit.

        Args:
            cloud: The object's points [m]; points without depth are ignored.
            grasps: In the cloud's frame.
            tare: A reading without contact, taken shortly before.
            residuals: Of earlier touches on the same object. Their own tare is used, and `tare` must be omitted.
            history: Readings of the hand so far, which include tares; `tare` and `residuals` must be omitted.
            limits: Range and size of objects.
            reach: Of the hand.

        Returns:
            One prediction a grasp, in order; a grasp that no hand can execute is refused with a reason. `reference`
            names the strongest reading that it was adapted to: touches of the object, tare, history or none. Flags:
            `out_of_range` where a value leaves the model's ranges (it is not clipped), `unfamiliar` where cloud or
            grasp is out of the training distribution.

        Raises:
            CloudError: If the cloud holds too few points or all at one position, or is out of `limits`.
            ModelError: If the cloud lacks a colour that the model needs; if readings are given to a model without
                calibration, or in more than one form; if residuals or history are of another model.
            TactileError: If the tare is not a reading of working sensors.
        """
        if residuals is not None:
            if tare is not None:
                raise ModelError("tare: the residuals have their own")
            if residuals.model.sha256 != self.sha256:
                raise ModelError(f"{self.name}: residuals: are of {residuals.model.name}, which predicts otherwise")
            self._require_calibration()
            tare = residuals.tare
        if history is not None and (tare is not None or residuals is not None):
            raise ModelError("history: has tares and touches of its own")
        if history is not None and history.tracker.parameters is not self.new_tracker().parameters:
            raise ModelError(f"{self.name}: history: is of another model, which predicts otherwise")
        check_object(cloud.xyz, limits)
        grasps = GraspList(grasps)
        refusals = _refusals(grasps, cloud, reach.max_width_m, reach.max_distance_m)
        if any(refusals):
            usable = GraspList(grasp for grasp, reason in zip(grasps, refusals, strict=True) if not reason)
            predicted = iter(self._predict(cloud, usable, tare, residuals, history))
            return [
                TouchPrediction(grasp, None, status="bad_grasp", reason=reason) if reason else next(predicted)
                for grasp, reason in zip(grasps, refusals, strict=True)
            ]
        return self._predict(cloud, grasps, tare, residuals, history)

    def _predict(
        self,
        cloud: Cloud,
        grasps: Sequence[Grasp],
        tare: Touch | None,
        residuals: ObjectResiduals | None,
        history: History | None,
    ) -> Sequence[TouchPrediction]:
        """Predictions for executable grasps."""
        estimate = self._estimator.estimate(cloud, grasps)
        if residuals is None and self._unread is not None:
            if history is None and tare is not None:
                history = self._history_of(tare)
            adapted = self._by_sight(estimate) if history is None else history.adapt(estimate)
        else:
            adapted = self._adapted(estimate, tare, residuals)
        if self._widen is not None:
            adapted = replace(adapted, half=adapted.half * self._widen)
        return self._predictions(grasps, estimate.in_distribution, adapted)

    def _by_sight(self, estimate: Estimate) -> _Adapted:
        """As `History.adapt` of a hand of which nothing was read, whose levels are computed once."""
        known, new = self._unread_levels
        inside = estimate.in_distribution[:, None]
        offset, half = (np.where(inside, *pair) for pair in zip(known, new, strict=True))
        return _Adapted(estimate.counts + offset, half, "none", Evidence())

    @cached_property
    def _unread_levels(self) -> tuple[tuple[Float64, Float64], tuple[Float64, Float64]]:
        """(50,) offset and half widths of known and of new objects [counts]."""
        tracker = self.new_tracker()
        levels = (tracker.level(0, same_object=False, known=known) for known in (True, False))
        (known, known_half), (new, new_half) = (tracker.adapt(one, np.zeros((1, TOUCH_SIZE))) for one in levels)
        return (known[0], known_half[0]), (new[0], new_half[0])

    def _history_of(self, tare: Touch) -> History:
        """A hand of which nothing was read but a tare, just now."""
        tracker = self.new_tracker()
        tracker.add_tare(0, self.tare_offset(tare))
        return History(tracker, 0, tare=True)

    def _adapted(self, estimate: Estimate, tare: Touch | None, residuals: ObjectResiduals | None) -> _Adapted:
        """Adapted to a tare and to touches of one object in closed form."""
        counts = self._shifted(estimate.counts, tare)
        touches = residuals.count if residuals is not None else 0
        half = np.full_like(counts, np.nan)
        if self.calibration is not None:
            touched = residuals.means() if residuals is not None else None
            counts, half = self.calibration.adapt(
                counts, estimate.in_distribution, tare=tare is not None, touched=touched, count=touches
            )
        reference: Reference = "touches" if touches else "none" if tare is None else "tare"
        return _Adapted(counts, half, reference, Evidence(touches=touches))

    def expect(
        self, cloud: Cloud, grasps: Sequence[Grasp], tare: Touch | None = None, limits: ObjectLimits = DEFAULT_LIMITS
    ) -> Float64:
        """(K, 50) predictions before any touch, which readings are compared with [counts].

        Raises as `predict`, and a `GraspError` for a grasp that no hand can execute.
        """
        self._require_calibration()
        return self._shifted(self.estimate_executed(cloud, grasps, limits).counts, tare)

    def estimate_executed(
        self, cloud: Cloud, grasps: Sequence[Grasp], limits: ObjectLimits = DEFAULT_LIMITS
    ) -> Estimate:
        """Predictions by sight for grasps that were executed; raises as `expect`."""
        check_object(cloud.xyz, limits)
        # These grasps were executed, maybe beside the cloud, but not out of the sensor's range.
        refusals = _refusals(grasps, cloud, _EXECUTED_WIDTH_M, limits.max_range_m)
        usable = [grasp for grasp, reason in zip(grasps, refusals, strict=True) if not reason]
        estimate = self._estimator.estimate(cloud, usable)  # a useless cloud is named first
        if any(refusals):
            raise GraspError(next(filter(None, refusals)))
        return estimate

    def tare_offset(self, tare: Touch) -> Float64:
        """(50,) a tare minus the rest level of the model [counts].

        Raises:
            ModelError: If the model has no rest level.
            TactileError: If the tare is not a reading of working sensors.
        """
        if self.calibration is None:
            raise ModelError(f"{self.name}: tare: cannot be used: its card holds no rest level")
        faults = check_touch(tare).faults
        if faults:
            raise TactileError(f"tare: {faults[0]}")
        return tare.vector() - self.calibration.rest

    def _require_calibration(self) -> None:
        if self.calibration is None:
            raise ModelError(f"{self.name}: cannot adapt to touches: its card holds no calibration")

    def _shifted(self, counts: Float64, tare: Touch | None) -> Float64:
        """Counts at the rest level of training, shifted to that of the tare."""
        return counts if tare is None else counts + self.tare_offset(tare)

    def _predictions(
        self, grasps: Sequence[Grasp], in_distribution: npt.NDArray[np.bool_], adapted: _Adapted
    ) -> Sequence[TouchPrediction]:
        if not grasps:
            return []
        counts, half = adapted.counts, adapted.half
        outside: list[bool] = np.any(self.ranges.outside(counts), axis=1).tolist()
        known: list[bool] = in_distribution.tolist()
        flags = [_FLAGS[pair] for pair in zip(outside, known, strict=True)]
        bounds = None if self.calibration is None else (counts - half, counts + half)
        reason = "the model gives a value that is not finite"
        refused = {
            k: TouchPrediction(grasps[k], None, status="refused", reason=reason)
            for k in np.flatnonzero(~np.isfinite(counts).all(axis=1)).tolist()
        }
        return TouchPredictions(grasps, counts, bounds, flags, adapted.reference, adapted.evidence, refused)


def _refusals(grasps: Sequence[Grasp], cloud: Cloud, max_width_m: float, max_distance_m: float) -> list[str]:
    """Why no hand can execute each grasp; "" where one can."""
    g1, g2, rotations = stacked(grasps)
    fine = surely_rotations(rotations) & surely_in_reach(g1, g2, cloud.xyz, max_width_m, max_distance_m)
    return [
        "" if one else _refusal(grasp, cloud, max_width_m, max_distance_m)
        for grasp, one in zip(grasps, fine.tolist(), strict=True)
    ]


def _refusal(grasp: Grasp, cloud: Cloud, max_width_m: float, max_distance_m: float) -> str:
    """Why no hand can execute a grasp; "" if one can."""
    try:
        check_rotation(grasp.rotation)
        check_reach(grasp, cloud.xyz, max_width_m, max_distance_m)
    except GraspError as err:
        return str(err)
    return ""


class ObjectResiduals:
    """Readings of earlier touches on one object, and a model's predictions for the same grasps.

    Only their sums are kept, so the cost of a later prediction does not depend on the number of touches.

    Args:
        model: Makes the predictions that readings are compared with.
        tare: A reading without contact, if there is one; predictions that use these residuals are shifted to it.

    Attributes:
        count: Number of touches.
    """

    def __init__(self, model: TouchModel, tare: Touch | None = None) -> None:
        self.model = model
        self.tare = tare
        self.count = 0
        self._read = np.zeros(TOUCH_SIZE)
        self._expected = np.zeros(TOUCH_SIZE)

    def add(self, cloud: Cloud, grasp: Grasp, reading: Touch, limits: ObjectLimits = DEFAULT_LIMITS) -> None:
        """Add the reading of an executed grasp.

        Args:
            cloud: The cloud that the grasp was planned on.
            grasp: As executed.
            reading: Both fingers in contact [counts].
            limits: Range and size of objects.

        Raises:
            TactileError: If the reading, or the tare, is not that of working sensors.
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute the grasp.
            ModelError: If the model has no calibration, or refuses the cloud.
        """
        faults = check_touch(reading).faults
        if faults:
            raise TactileError(f"touched: {faults[0]}")
        self._expected += self.model.expect(cloud, [grasp], self.tare, limits)[0]
        self._read += reading.vector()
        self.count += 1

    def means(self) -> tuple[Float64, Float64]:
        """(50,) mean of the predictions and of the readings [counts]; zeros before the first touch."""
        count = max(self.count, 1)
        return self._expected / count, self._read / count
