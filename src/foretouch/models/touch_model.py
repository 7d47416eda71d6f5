# SPDX-License-Identifier: Apache-2.0
"""Prediction of touch: one cloud and K grasps in, K predictions out, with an interval, a reference and flags.

cloud, K grasps ─ estimator ─► counts ─ tracker of earlier readings ─► value ± half width, flags

Earlier readings are a tare, touches of the same object, or the history of a hand with many objects. All of them go
through the tracker of the sensors' state (`models.tracker`), with the parameters of the model's calibration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits, check_object
from foretouch.errors import FileError, ModelError, TactileError
from foretouch.files import read_bytes, replace_files, system_errors
from foretouch.grasp.pose import joined_faults, require_none, rotation_faults
from foretouch.grasp.reach import DEFAULT_REACH, ReachConfig, reach_faults
from foretouch.models.calibration import Calibration, tare_offset
from foretouch.models.card import card_sensor
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import Ranges, touch_faults
from foretouch.tactile.dead_taxels import usable
from foretouch.tactile.description import require_same
from foretouch.types import Bool, Cloud, Evidence, Float64, Grasp, Grasps, Plane, Predictions, Reference, Touch
from foretouch.types.arrays import objects
from foretouch.types.grasps import contact_faults

SIMILAR_TOUCHES: Final = "similar_touches"
"""Flag of predictions in which took part where on the object its earlier touches were."""


UNFAMILIAR: Final[Mapping[str, str]] = {
    "larger_object": "the object is larger than any of the training",
    "smaller_object": "the object is smaller than any of the training",
    "other_shape": "no object of the training has these proportions",
    "wider_grasp": "the contacts are farther apart than in the training",
    "narrower_grasp": "the contacts are nearer to each other than in the training",
    "other_direction": "the hand comes from a direction that the training lacks",
    "sparse_points": "the points are too few for this object",
}
"""Flags beside `unfamiliar`, and what they mean. Touch the object, or train on 20 grasps of such ones."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Predictions for K grasps on one cloud, before tare, touches and intervals are applied."""

    counts: Float64  # (K, D) float64 [counts]
    in_distribution: Bool  # (K,) bool: whether cloud and grasp resemble the training
    where: Float64 | None = None  # (K, P) features of the grasps, by which touches of one object are compared
    reasons: Mapping[str, Bool] = field(
        default_factory=dict
    )  # (K,) bool each, why grasps are not in distribution, by flag


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Readings of one hand up to a time, for predictions at that time."""

    tracker: SensorTracker  # of the model's calibration
    stamp_ns: int  # time of the predictions [ns]
    same_object: bool = True  # whether they are for the object that was touched last
    tare: bool = False  # whether a tare was taken shortly before
    tdc: Float64 | None = None  # (F,) TDC of the fingers at that time [counts]; None: the latest one

    def adapt(self, estimate: Estimate) -> tuple[Float64, Float64]:
        """Return (K, D) predictions adapted to the readings, and the half widths of their intervals [counts]."""
        counts, half = np.empty((2, *estimate.counts.shape))
        for known in (False, True):
            rows = estimate.in_distribution == known
            if rows.any():
                level = self.tracker.level(self.stamp_ns, same_object=self._touched, known=known, tdc=self.tdc)
                where = None if estimate.where is None else estimate.where[rows]
                counts[rows], half[rows] = self.tracker.adapt(level, estimate.counts[rows], where)
        return counts, half

    @property
    def evidence(self) -> Evidence:
        """Numbers and ages of the readings."""
        return self.tracker.evidence(self.stamp_ns, same_object=self._touched)

    @property
    def reference(self) -> Reference:
        """The strongest of the readings."""
        read: Reference = "tare" if self.tare else "history" if self.evidence.readings else "none"
        return "touches" if self._touched else read

    @property
    def _touched(self) -> bool:
        return self.same_object and self.tracker.touches > 0


class Estimator(Protocol):
    """Predicts touch from the cloud and the grasp alone; what the kinds of touch models implement."""

    @property
    def ranges(self) -> Ranges:
        """Ranges outside which a predicted value is flagged."""
        ...

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """Predict K grasps; the cloud's features are computed once. Without a table the camera looks straight down on it.

        Raises:
            CloudError: If the cloud holds too few points or all at one position.
            ModelError: If it lacks a channel that the model needs.
        """
        ...


class HasCloud(Protocol):
    """What stands for a cloud, such as an object of a scene."""

    @property
    def cloud(self) -> Cloud:
        """Its points."""
        ...


class TouchModel:
    """Predicts what both fingertips would read at a grasp. It never changes, so threads may share it.

    Args:
        estimator: Predicts from the cloud and the grasp only.
        card: The card of the model.
        calibration: Rest level, adaptation and intervals; None if the card holds no calibration.

    Attributes:
        name: Name of the model, from its card.
        sha256: Hash of the weights, from the card.
        sensor: The sensor whose readings are predicted.
        ranges: Ranges outside which a predicted value is flagged.
        estimator: Predicts from the cloud and the grasp only.
    """

    def __init__(self, estimator: Estimator, card: Mapping[str, Any], calibration: Calibration | None = None) -> None:
        self.name: str = card["name"]
        self.sha256: str = card["sha256"]
        self.card = dict(card)
        self.calibration = calibration
        self.sensor = card_sensor(card, self.name)
        self.ranges = estimator.ranges
        self.estimator = estimator
        self.path: Path | None = None  # of its card, where it was loaded

    @property
    def simulated(self) -> bool:
        """Whether it was trained on simulated grasps, and so predicts for the simulated hand only."""
        return "scene_sha256" in self.card.get("data", {})

    def save(self, folder: str | Path) -> Path:
        """Write card, weights and calibration to a folder, for `load_model`.

        Args:
            folder: It is made if it does not exist.

        Returns:
            The path of the card.

        Raises:
            ModelError: If it was not loaded from files.
            FileError: If a file exists or cannot be written.
        """
        if self.path is None:
            raise ModelError(f"{self.name}: was not loaded from files, so it cannot be saved")
        names = [self.path.name, self.card["weights"], (self.card.get("calibration") or {}).get("weights")]
        folder = Path(folder)
        files = {folder / name: read_bytes(self.path.with_name(name)) for name in names if name}
        for path in files:
            if path.exists():
                raise FileError(path, "exists already; choose another folder")
        with system_errors(folder, "cannot be written"):
            folder.mkdir(parents=True, exist_ok=True)
        replace_files(files)
        return folder / self.path.name

    def new_tracker(self) -> SensorTracker:
        """Make a tracker of a hand, of which nothing was read yet.

        Raises:
            ModelError: If the model has no calibration.
        """
        return SensorTracker(self._calibrated().tracker_parameters)

    def predict(
        self,
        cloud: Cloud | HasCloud,
        grasps: Sequence[Grasp],
        *,
        tare: Touch | None = None,
        history: Snapshot | None = None,
        limits: ObjectLimits = DEFAULT_LIMITS,
        reach: ReachConfig = DEFAULT_REACH,
        table: Plane | None = None,
    ) -> Predictions:
        """Predict the readings of both fingertips at each grasp.

        Predictions are deterministic, and independent of the other grasps of the call to the last bit.

        Args:
            cloud: The object's points [m], or an object of a scene; points without depth are ignored.
            grasps: In the cloud's frame.
            tare: A reading without contact, taken shortly before, of a hand of which nothing else was read.
            history: Readings of the hand so far, which include tares; `tare` must be omitted.
            limits: Range and size of objects.
            reach: Of the hand.
            table: In the cloud's frame; of an object of a scene its own. Without one the camera is taken to look straight
                down on the table, as in the public recordings.

        Returns:
            A row for each grasp, in order; a grasp that no hand can execute is refused with a reason. `reference`
            names the strongest reading that it was adapted to: touches of the object, tare, history or none. Flags:
            `out_of_range` where a value leaves the model's ranges (it is not clipped), `unfamiliar` where cloud or
            grasp is out of the training distribution, with a reason from `UNFAMILIAR`, `similar_touches` where the places of earlier touches took part.

        Raises:
            CloudError: If the cloud holds too few points or all at one position, or is out of `limits`.
            ModelError: If the cloud lacks a colour that the model needs; if readings are given to a model without
                calibration, or in more than one form; if the history is of another model.
            TactileError: If the tare is not a reading of working sensors.
        """
        if history is not None:
            if tare is not None:
                raise ModelError("history: has tares and touches of its own")
            if history.tracker.parameters is not self._calibrated().tracker_parameters:
                raise ModelError(f"{self.name}: history: is of another model, which predicts otherwise")
        if not isinstance(cloud, Cloud):
            table, cloud = table or getattr(cloud, "plane", None), cloud.cloud
        check_object(cloud.xyz, limits)
        columns = Grasps.of(grasps)
        faults = _faults(columns, cloud, reach.max_width_m, reach.max_distance_m)
        usable = np.array([not fault for fault in faults], np.bool_)
        if usable.all():
            return self._predict(cloud, columns, tare, history, table)
        predictions = self._predict(cloud, columns.take(usable), tare, history, table)  # a useless cloud is named first
        return Predictions.refused(columns, self.sensor.channels, "bad_grasp", faults).put(usable, predictions)

    def _predict(
        self, cloud: Cloud, grasps: Grasps, tare: Touch | None, history: Snapshot | None, table: Plane | None
    ) -> Predictions:
        """Return predictions for executable grasps."""
        estimate = self.estimator.estimate(cloud, grasps, table)
        if tare is not None:
            tracker = self.new_tracker()
            tracker.add_tare(0, self.tare_offset(tare))
            history = Snapshot(tracker, 0, same_object=False, tare=True)
        known = estimate.in_distribution
        if history is not None and history.evidence.readings:
            read = (*history.adapt(estimate), history.reference, history.evidence)
            similar = history.same_object and history.tracker.similar.enough and estimate.where is not None
            predictions = self._predictions(grasps, estimate, *read)
            return predictions.flagged(SIMILAR_TOUCHES) if similar else predictions
        half = None
        if self.calibration is not None:
            half = np.where(known[:, None], *(self.calibration.unread_half_widths[name] for name in ("known", "new")))
        return self._predictions(grasps, estimate, estimate.counts, half, "none", Evidence())

    def estimate_executed(
        self, cloud: Cloud, grasps: Sequence[Grasp], limits: ObjectLimits = DEFAULT_LIMITS, table: Plane | None = None
    ) -> Estimate:
        """Predict by vision the readings of grasps that were executed, to compare them with what was read.

        Args:
            cloud: The object's points [m].
            grasps: K grasps in the cloud's frame.
            limits: Range and size of objects.
            table: In the cloud's frame; without one the camera is taken to look straight down on it.

        Raises:
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute a grasp.
        """
        check_object(cloud.xyz, limits)
        # These grasps were executed, maybe beside the cloud, but not out of the sensor's range or wider than any hand.
        columns = Grasps.of(grasps)
        faults = _faults(columns, cloud, 2.0, limits.max_range_m)
        usable = np.array([not fault for fault in faults], np.bool_)
        estimate = self.estimator.estimate(cloud, columns.take(usable), table)  # a useless cloud is named first
        require_none(faults)
        return estimate

    def tare_offset(self, tare: Touch) -> Float64:
        """Compute the difference of a tare from the rest level of the model.

        Args:
            tare: A reading without contact.

        Returns:
            (D,) float64, in the unit of each channel.

        Raises:
            ModelError: If the model has no calibration.
            TactileError: If the tare is of another sensor, or not a reading of working sensors.
        """
        rest = self._calibrated().rest
        return tare_offset(Touch(self.usable_values(tare, "tare"), tare.channels), rest)

    def usable_values(self, touch: Touch, what: str) -> Float64:
        """Return the values of a reading that can be used.

        Args:
            touch: The reading.
            what: What it is, for the error.

        Returns:
            (D,) float64; NaN of taxels that are dead in the training data, or whose reading cannot be used.

        Raises:
            TactileError: If the reading is of another sensor, or not of working ones. The message names `what`.
        """
        require_same(touch.channels, self.sensor.channels, what)
        if faults := touch_faults(touch):
            raise TactileError(f"{what}: {faults[0]}")
        return usable(touch.values, touch.channels, self.sensor.valid_values)

    def _calibrated(self) -> Calibration:
        if self.calibration is None:
            raise ModelError(f"{self.name}: cannot adapt to readings: its card holds no calibration")
        return self.calibration

    def _predictions(
        self,
        grasps: Grasps,
        estimate: Estimate,
        counts: Float64,
        half: Float64 | None,
        reference: Reference,
        evidence: Evidence,
    ) -> Predictions:
        """Return rows of values with their intervals and flags; a row that is not finite is refused."""
        half = np.full(counts.shape, np.nan) if half is None else half
        finite = np.asarray(np.isfinite(counts).all(axis=1), np.bool_)
        outside = self.ranges.outside(counts).any(axis=1) & finite
        unknown = ~estimate.in_distribution & finite
        marks = {"out_of_range": outside, "unfamiliar": unknown}
        marks |= {flag: rows & unknown for flag, rows in estimate.reasons.items()}
        marked = {flag: rows.tolist() for flag, rows in marks.items() if rows.any()}
        flags = [tuple(flag for flag, rows in marked.items() if rows[k]) for k in range(len(grasps))]
        predictions = Predictions(
            counts,
            grasps,
            self.sensor.channels,
            counts - half,
            counts + half,
            flags=objects(flags),
            reference=objects([reference] * len(grasps)),
            evidence=objects([evidence] * len(grasps)),
        )
        if finite.all():
            return predictions
        reason = "the model gives a value that is not finite"
        refused = Predictions.refused(grasps.take(~finite), self.sensor.channels, "refused", reason)
        return predictions.put(~finite, refused)


def _faults(grasps: Grasps, cloud: Cloud, max_width_m: float, max_distance_m: float) -> list[str]:
    """Return why no hand can execute each grasp; "" where one can."""
    return joined_faults(
        contact_faults(grasps.g1, grasps.g2, grasps.rotation),
        rotation_faults(grasps.rotation),
        reach_faults(grasps, cloud.xyz, max_width_m, max_distance_m),
    )
