# SPDX-License-Identifier: Apache-2.0
"""Prediction of touch, and the history of the readings that it is adapted to.

One cloud and K grasps come in, K predictions go out, each with an interval, a reference and flags.

cloud, K grasps ─ predictor ─► counts ─ tracker of earlier readings ─► value ± half width, flags

Earlier readings are a tare, touches of the same object, or the history of a hand with many objects. All of them go
through the tracker of the sensors' state (`models.tracker`), with the parameters of the model's calibration.
"""

import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from foretouch.base.files import as_path, read_bytes, replace_files, system_errors
from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits, check_object
from foretouch.errors import (
    CloudError,
    ConfigError,
    FileError,
    ForetouchError,
    GraspError,
    ModelError,
    TactileError,
    checked,
    described,
    raised_at,
    require_type,
    shown,
)
from foretouch.grasp.axis import with_rotations
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.pose import closing_faults, joined_faults
from foretouch.grasp.reach import DEFAULT_REACH, EXECUTED_M, OFF_OBJECT, ReachConfig, in_the_air, reach_faults
from foretouch.models.calibration import Calibration, tare_offset
from foretouch.models.card import OWN, card_sensor
from foretouch.models.equal_pressure import EQUAL_PRESSURE, equal_pressures
from foretouch.models.files import pack_history, to_bytes, to_text, under, unpack_history
from foretouch.models.predictor import Estimate, Predictor
from foretouch.models.tracker import SensorTracker, checked_stamp
from foretouch.tactile import Ranges, touch_faults, usual_ranges
from foretouch.tactile.dead_taxels import usable
from foretouch.tactile.description import require_same
from foretouch.types import AnyArray, Cloud, Evidence, Float64, Grasp, Grasps, Plane, Predictions, Reference, Touch
from foretouch.types.arrays import numbers, objects, scalar
from foretouch.types.grasps import contact_faults
from foretouch.types.rotations import are_absent, fault_texts, require_none
from foretouch.types.scene import Object
from foretouch.types.summary import Summarised, briefly, counted, names_of

_NOT_FINITE: Final = "the model gives a value that is not finite"

SIMILAR_TOUCHES: Final = "similar_touches"
"""Flag of predictions in which took part where on the object its earlier touches were."""

NO_TABLE: Final = "assumed_table"
"""Flag of predictions without a table: they hold if the camera looked straight down."""

_NO_MODEL: Final = "not a TouchModel, such as load_model()"
_NO_CHOICE: Final = "not True, False or None"
_NO_LIMITS: Final = "not ObjectLimits, such as ObjectLimits(max_range_m=2.0)"
_TRACKER: Final = "tracker/"
_TARE_EVERY_NS: Final = 60 * 10**9  # more often, the error that successive tares share would be counted as many

_POSING: Final = GeoGraspConfig()  # by which rotations are computed that are not given
_NO_ROTATION: Final = "rotation: is not given, and computing it needs the table; pass an object of a scene, or table"

_SAME_OBJECT_M: Final = 0.02
"""How far an object may have moved, or changed in apparent size, since it was touched."""


class TouchModel(Summarised):
    """Predicts what both fingertips would read at a grasp. It never changes, so threads may share it.

    Args:
        predictor: Predicts from the cloud and the grasp only.
        card: The card of the model.
        calibration: Rest level, adaptation and intervals; None if the card holds no calibration.

    Attributes:
        name: Name of the model, from its card.
        sha256: Hash of the weights, from the card.
        sensor: The sensor whose readings are predicted.
        ranges: Ranges outside which a predicted value is flagged.
        predictor: Predicts from the cloud and the grasp only.
    """

    def __init__(self, predictor: Predictor, card: Mapping[str, Any], calibration: Calibration | None = None) -> None:
        if not callable(getattr(predictor, "estimate", None)):
            raise ModelError(f"predictor: {shown(predictor)} has no estimate(cloud, grasps, table=None)")
        if not isinstance(card, Mapping) or not all(isinstance(card.get(name), str) for name in ("name", "sha256")):
            rule = "holds no name and sha256; load_model(…) reads a card, and calibrate(predictor, samples) makes one"
            raise ModelError(f"card: {shown(card)} {rule}")
        require_type(card.get("data", {}), Mapping, "card: data", "not a mapping", ModelError)
        if not isinstance(calibration, Calibration | None):
            raise ModelError(f"calibration: {type(calibration).__name__} is not a Calibration")
        self.name: str = card["name"]
        self.sha256: str = card["sha256"]
        self.card = dict(card)
        self.calibration = calibration
        self.sensor = card_sensor(card, self.name)
        self.ranges: Ranges = getattr(predictor, "ranges", None) or usual_ranges(self.sensor.channels)
        self.predictor = predictor
        self.path: Path | None = None  # of its card, where it was loaded

    def _summary(self) -> tuple[str, dict[str, str]]:
        data = self.card.get("data", {})
        objects = data.get("objects")
        trained = f"{data['samples']} samples" if "samples" in data else ""
        skills = {
            split: np.mean([row["skill"] for row in by.values()]) for split, by in self.card.get("skill", {}).items()
        }
        return f"{shown(self.name, 40)}, {self.card.get('kind', 'own')}", {
            "sensor": briefly(self.sensor),
            "trained on": f"{trained} of {counted(len(objects), 'object')}" if objects else trained,
            "hand": "simulated" if self.simulated else "",
            "mean skill": names_of([f"{split} {value:.2f}" for split, value in skills.items()]),
            "intervals": "none: not calibrated" if self.calibration is None else "90 %, adapted to readings",
            "sha256": self.sha256[:16],
            "card": "" if self.path is None else shown(self.path, 80),
        }

    @property
    def uses_colours(self) -> bool:
        """Whether it predicts from the colours of the points; of a predictor that does not state it, they are taken to be used."""
        return bool(getattr(self.predictor, "uses_colours", True))

    @property
    def simulated(self) -> bool:
        """Whether it was trained on simulated grasps, and so predicts for the simulated hand only."""
        return "scene_sha256" in self.card.get("data", {})

    def is_same(self, other: "TouchModel") -> bool:
        """Return whether another model is this one, or was loaded from a copy of its files.

        Args:
            other: The other model.
        """
        require_type(other, TouchModel, "other", _NO_MODEL, ModelError)
        loaded = self.path is not None and other.path is not None
        return other is self or (loaded and other.card == self.card)  # which has the hashes of the other files

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
        folder = as_path(folder)
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
        cloud: Cloud | Object,
        grasps: Sequence[Grasp],
        *,
        tare: Touch | None = None,
        history: "History | Readings | None" = None,
        limits: ObjectLimits = DEFAULT_LIMITS,
        reach: ReachConfig = DEFAULT_REACH,
        table: Plane | None = None,
    ) -> Predictions:
        """Predict the readings of both fingertips at each grasp: in Python, of the commands, and of the graph.

        Predicted values are deterministic, and independent of the other grasps of the call to the last bit.

        Args:
            cloud: The object's points [m], or an object of a scene, whose flags the predictions get; points without depth
                are ignored.
            grasps: In the cloud's frame. Rotations that are not given, as in `Grasps(g1, g2)`, are computed as the planner
                does; this needs the table.
            tare: A reading without contact, taken shortly before, of a hand of which nothing else was read.
            history: Readings of the hand so far, which include tares; `tare` must be omitted. Of a `History` those `at` now.
            limits: Range and size of objects.
            reach: Of the hand.
            table: In the cloud's frame; of an object of a scene its own. Without one the camera is taken to look straight
                down on the table, as in the public recordings.

        Returns:
            A row for each grasp, in order; a grasp that no hand can execute is refused with a reason. `reference`
            names the strongest reading that it was adapted to: touches of the object, tare, history or none. Flags:
            `out_of_range` where a value leaves the model's ranges (it is not clipped), `unfamiliar` where cloud or
            grasp is out of the training distribution, with a reason from `UNFAMILIAR`, `similar_touches` where the places of earlier touches took part,
            those of the grasps, such as `beside_unseen`, `off_object` where a contact is in the air, `assumed_table` without a table, and `equal_pressure` where
            grasps of the call cannot be ranked by pressure.

        Raises:
            CloudError: If the cloud holds too few points or all at one position, or is out of `limits`.
            ModelError: If the cloud lacks a colour that the model needs; if readings are given to a model without
                calibration, or in more than one form; if the history is of another model.
            TactileError: If the tare is not a reading of working sensors.
        """
        if history is not None:
            if tare is not None:
                raise ModelError("history: has tares and touches of its own")
            if not isinstance(history, History | Readings):
                raise ModelError(f"history: {type(history).__name__} is not a History")
            self._calibrated()
            if not self.is_same(history.model):
                raise ModelError(f"{self.name}: history: is of another model, which predicts otherwise")
            history = history.at(None, cloud) if isinstance(history, History) else history
        flags = cloud.flags if isinstance(cloud, Object) else ()
        cloud, table = _cloud_and_table(cloud, table)
        require_type(
            reach, ReachConfig, "reach", "not a ReachConfig, such as ReachConfig(max_width_m=0.1)", ConfigError
        )
        require_type(limits, ObjectLimits, "limits", _NO_LIMITS, ConfigError)
        check_object(cloud.xyz, limits)
        columns = with_rotations(Grasps.of(grasps), cloud, table, _POSING)
        faults = _faults(columns, cloud, reach.max_width_m, reach.max_distance_m)
        usable = np.array([not fault for fault in faults], np.bool_)
        graspable = columns if usable.all() else columns.take(usable)
        estimate = self._estimate(cloud, graspable, table)  # a useless cloud is named first
        read = history if tare is None else self.after_tare(tare)
        predictions = self._adapted(graspable, estimate, read)
        off = np.zeros(len(columns), np.bool_)
        off[usable] = in_the_air(graspable, cloud.xyz)
        if not usable.all():
            refused = Predictions.refused(columns, self.sensor.channels, "bad_grasp", faults)
            predictions = refused.put(usable, predictions)
        of_grasps = dict.fromkeys(flag for own in columns.flags for flag in own)
        return predictions.marked(
            (OFF_OBJECT, off),
            (NO_TABLE, usable if table is None or table.assumed else False),
            *((flag, True) for flag in flags),
            *((flag, np.array([flag in own for own in columns.flags])) for flag in of_grasps),
            (EQUAL_PRESSURE, equal_pressures(predictions, self)),
        )

    def _adapted(self, grasps: Grasps, estimate: Estimate, read: "Readings | None") -> Predictions:
        """Return the predictions of an estimate of executable grasps, adapted to what the hand has read."""
        if read is not None and read.evidence.readings:
            predictions = self._predictions(grasps, estimate, *read.adapt(estimate), read.reference, read.evidence)
            return predictions.flagged(SIMILAR_TOUCHES, read.compares_places and estimate.where is not None)
        half = None
        if self.calibration is not None:
            half = np.where(
                estimate.known[:, None], *(self.calibration.unread_half_widths[name] for name in ("known", "new"))
            )
        return self._predictions(grasps, estimate, estimate.counts, half, "none", Evidence())

    def estimate(self, cloud: Cloud | Object, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """Predict K grasps from the cloud alone, without readings and intervals.

        Args:
            cloud: The object's points [m], or an object of a scene.
            grasps: In the cloud's frame. Rotations that are not given are computed as of `predict`, but for an own predictor.
            table: In the same frame; of an object its own. Without one the camera is taken to look straight down on it.

        Raises:
            CloudError: If the cloud cannot be used.
            GraspError: If a rotation is not given and cannot be computed, since there is no table.
            ModelError: If the cloud lacks a colour that the model needs; or of an own predictor that fails, or returns no
                K x D numbers: names it, the error and the line.
        """
        cloud, table = _cloud_and_table(cloud, table)
        grasps = Grasps.of(grasps)
        if self.card.get("kind") != OWN:
            grasps = with_rotations(grasps, cloud, table, _POSING)
            require_none(_absent_faults(grasps))
        return self._estimate(cloud, grasps, table)

    def _estimate(self, cloud: Cloud, grasps: Grasps, table: Plane | None) -> Estimate:
        """Return what the predictor answers, checked where it is of a user."""
        try:
            if self.card.get("kind") == OWN:  # which may write into what it is given
                answer = self.predictor.estimate(*copy.deepcopy((cloud, grasps)), table)
            else:
                answer = self.predictor.estimate(cloud, grasps, table)
        except ForetouchError:
            raise
        except (Exception, SystemExit) as err:
            if self.card.get("kind") != OWN:  # an error of foretouch is reported as one
                raise
            raise ModelError(f"{self.name}: estimate: {described(err)}{raised_at(err)}") from err
        if isinstance(answer, Estimate) and self.card.get("kind") != OWN:
            return answer
        try:
            return Estimate.of(answer, len(grasps), self.sensor.channels.size)
        except ModelError as err:
            raise ModelError(f"{self.name}: {err}") from err

    def estimate_executed(
        self,
        cloud: Cloud | Object,
        grasps: Sequence[Grasp],
        limits: ObjectLimits = DEFAULT_LIMITS,
        table: Plane | None = None,
    ) -> Estimate:
        """Predict by vision the readings of grasps that were executed, to compare them with what was read.

        Args:
            cloud: The object's points [m], or an object of a scene.
            grasps: K grasps in the cloud's frame.
            limits: Range and size of objects.
            table: In the cloud's frame; of an object its own. Without one the camera is taken to look straight down on it.

        Raises:
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute a grasp.
            ModelError: If a value is not finite.
        """
        cloud, table = _cloud_and_table(cloud, table)
        require_type(limits, ObjectLimits, "limits", _NO_LIMITS, ConfigError)
        check_object(cloud.xyz, limits)
        # These grasps were executed, maybe beside the cloud, but not out of the sensor's range or wider than any hand.
        columns = with_rotations(Grasps.of(grasps), cloud, table, _POSING)
        faults = _faults(columns, cloud, EXECUTED_M, limits.max_range_m)
        usable = np.array([not fault for fault in faults], np.bool_)
        estimate = self._estimate(cloud, columns.take(usable), table)  # a useless cloud is named first
        require_none(faults)
        if not np.isfinite(estimate.counts).all():
            raise ModelError(f"{self.name}: {_NOT_FINITE}")
        return estimate

    @property
    def rest(self) -> Touch | None:
        """Reading without contact, as the sensors of the training had it; None of a model without a calibration."""
        return None if self.calibration is None else Touch(self.calibration.rest, self.sensor.channels)

    def after_tare(self, tare: Touch) -> "Readings":
        """Return what is known of a hand of which nothing but a reading without contact was read, taken shortly before.

        Args:
            tare: The reading.

        Raises:
            ModelError: If the model has no calibration.
            TactileError: If the tare is of another sensor, or not a reading of working sensors.
        """
        hand = History(self)
        hand.tare(tare, stamp_ns=0)
        return hand.at(0, same_object=False)

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
            TactileError: If the reading is of another sensor, or not of working ones, or no `Touch`. The message names `what`.
        """
        if not isinstance(touch, Touch):
            rule = "is not a Touch, such as Touch(values, model.sensor.channels)"
            raise TactileError(f"{what}: {type(touch).__name__} {rule}")
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
        unknown = finite & (False if estimate.familiar is None else ~estimate.familiar)
        reasons = ((flag, rows & unknown) for flag, rows in estimate.reasons.items())
        predictions = Predictions(
            counts,
            grasps,
            self.sensor.channels,
            counts - half,
            counts + half,
            reference=objects([reference] * len(grasps)),
            evidence=objects([evidence] * len(grasps)),
        ).marked(("out_of_range", outside), ("unfamiliar", unknown), *reasons)
        if finite.all():
            return predictions
        refused = Predictions.refused(grasps.take(~finite), self.sensor.channels, "refused", _NOT_FINITE)
        return predictions.put(~finite, refused)


def _checked_tdc(tdc: Any, model: TouchModel) -> Float64 | None:
    """Return (F,) temperatures of the fingers; a `TactileError` if they are none."""
    if tdc is None:
        return None
    values, wanted = numbers(tdc, "tdc", TactileError), (len(model.sensor.channels.fingers),)
    if values.shape != wanted:
        raise TactileError(f"tdc: shape {values.shape} is not {wanted}, one of each finger")
    return values


def _cloud_and_table(target: Cloud | Object, table: Plane | None = None) -> tuple[Cloud, Plane | None]:
    """Return the cloud and the table of an object; of a cloud no table, if none is given."""
    require_type(table, Plane | None, "table", "not a Plane, such as Plane.from_coefficients([a, b, c, d])", CloudError)
    if isinstance(target, Object):
        return target.cloud, table or target.plane
    if isinstance(target, Cloud):
        return target, table
    rule = "is neither an object of a scene, such as segment(cloud).objects[0], nor a Cloud of one"
    raise CloudError(f"cloud: {type(target).__name__} {rule}")


def place_and_size(cloud: Cloud) -> Float64:
    """Return (6,) float64 mean and standard deviation of the finite points of a cloud in x, y, z [m]; infinite without any."""
    points = cloud.finite.astype(np.float64)
    return np.concatenate([points.mean(axis=0), points.std(axis=0)]) if len(points) else np.full(6, np.inf)


@dataclass(frozen=True, eq=False, repr=False)
class Readings(Summarised):
    """What a hand had read at a time, for predictions on one object; of `History.at`."""

    model: TouchModel  # by whose predictions the readings are explained
    tracker: SensorTracker
    time_ns: int  # of the predictions [ns]
    same_object: bool  # whether they are on the object that was touched last
    tared: bool  # whether a tare was taken shortly before
    tdc: Float64 | None = None  # (F,) TDC of the fingers at that time [counts]; the latest one if None

    def _summary(self) -> tuple[str, dict[str, str]]:
        facts = {"model": briefly(self.model), "reference": self.reference}
        return f"{counted(self.evidence.readings, 'reading')}, {self.evidence.touches} of the object", facts

    def adapt(self, estimate: Estimate) -> tuple[Float64, Float64]:
        """Return (K, D) predictions adapted to the readings, and the half widths of their intervals [counts]."""
        require_type(estimate, Estimate, "estimate", "not an Estimate of this model", ModelError)
        estimate = Estimate.of(estimate, np.size(estimate.counts, 0), self.model.sensor.channels.size)
        counts, half = np.empty((2, *estimate.counts.shape))
        for known in (False, True):
            rows = estimate.known == known
            if rows.any():
                level = self.tracker.level(self.time_ns, same_object=self._touched, known=known, tdc=self.tdc)
                where = None if estimate.where is None else estimate.where[rows]
                counts[rows], half[rows] = self.tracker.adapt(level, estimate.counts[rows], where)
        return counts, half

    @cached_property
    def evidence(self) -> Evidence:
        """Numbers and ages of the readings."""
        return self.tracker.evidence(self.time_ns, same_object=self._touched)

    @property
    def reference(self) -> Reference:
        """The strongest of the readings."""
        if self._touched:
            return "touches"
        if self.tared:
            return "tare"
        return "history" if self.evidence.readings else "none"

    @property
    def compares_places(self) -> bool:
        """Whether places on the object are compared with its earlier touches."""
        return self.same_object and self.tracker.similar.enough

    @property
    def _touched(self) -> bool:
        return self.same_object and self.tracker.touches > 0


class History(Summarised):
    """What the fingertips of one hand have read so far, of whatever object. Use it in one thread at a time.

    Readings are compared with the predictions of one model, and the differences are fed to a `SensorTracker`. Another
    object forgets the last one's part and keeps the state of the sensors.

    Args:
        model: A model with a calibration.

    Raises:
        ModelError: If the model has no calibration, or is a name.

    Attributes:
        tracker: What the readings say about the sensors and the current object.
        signature: Frame and `place_and_size` of the current object at its last touch; None before its first.
        restarts: How often each finger was restarted, since its readings showed a jump or another sensor.
    """

    @checked
    def __init__(self, model: TouchModel) -> None:
        require_type(model, TouchModel, "model", _NO_MODEL, ModelError)
        self.model = model
        self.tracker = model.new_tracker()
        self.signature: tuple[str, Float64] | None = None
        self.restarts: dict[str, int] = {}
        self._tare_ns = -1
        self._forgotten = 0
        self._tared = False  # whether a tare was taken after the last touch

    def _summary(self) -> tuple[str, dict[str, str]]:
        read = self.at()
        evidence = read.evidence
        ages = {"touch": evidence.touch_age_s, "reading": evidence.reading_age_s}
        return f"{counted(evidence.readings, 'reading')}, {self.touches} of the object", {
            "model": briefly(self.model),
            "reference": read.reference,
            "last": names_of([f"{name} {age:.0f} s ago" for name, age in ages.items() if age is not None]),
            "restarted": names_of([f"{finger} {count}" for finger, count in self.restarts.items()]),
        }

    @property
    def touches(self) -> int:
        """Touches of the current object."""
        return self.tracker.touches

    @checked
    def tare(self, reading: Touch, *, stamp_ns: int | None = None, tdc: Float64 | None = None) -> tuple[str, ...]:
        """Add a reading without contact. One within a minute of the last is left out, since their errors are the same.

        Args:
            reading: Both fingers at rest, in the unit of the sensor.
            stamp_ns: When it was taken [ns]; now if None.
            tdc: (F,) temperature of the fingers [counts], where it is known.

        Returns:
            The fingers that were restarted, since their readings jumped.

        Raises:
            TactileError: If the reading is of another sensor or not of working ones, or older than the last one.
        """
        stamp_ns = time.time_ns() if stamp_ns is None else checked_stamp(stamp_ns)
        tdc = _checked_tdc(tdc, self.model)
        offset = self.model.tare_offset(reading)
        if self._tare_ns >= 0 and 0 <= stamp_ns - self._tare_ns < _TARE_EVERY_NS:
            self._tared = True
            return ()
        restarted = self.tracker.add_tare(stamp_ns, offset, tdc=tdc)
        self._tare_ns, self._tared = stamp_ns, True
        return self._counted(restarted)

    @checked
    def touched(
        self,
        target: Cloud | Object,
        grasp: Grasp,
        reading: Touch,
        *,
        stamp_ns: int | None = None,
        same_object: bool | None = None,
        estimate: Estimate | None = None,
        tdc: Float64 | None = None,
    ) -> tuple[str, ...]:
        """Add the reading of an executed grasp.

        Args:
            target: The object as it was seen before, or its cloud.
            grasp: As executed, in the frame of its cloud.
            reading: Both fingers in contact, in the unit of the sensor.
            stamp_ns: When it was taken [ns]; now if None.
            same_object: Whether the object was touched last, too; by default by place and size.
            estimate: The model's estimate of this grasp by `TouchModel.estimate_executed`; by default it is made here.
            tdc: (F,) temperature of the fingers [counts], where it is known.

        Returns:
            The fingers that were restarted, since their readings jumped.

        Raises:
            TactileError: If the reading is of another sensor or not of working ones, or older than the last one.
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute the grasp, or it is on another object.
            ModelError: If the estimate is not of one grasp.
        """
        cloud, table = _cloud_and_table(target)
        require_type(same_object, bool | np.bool_ | None, "same_object", _NO_CHOICE, ModelError)
        require_type(estimate, Estimate | None, "estimate", "not an Estimate of this model", ModelError)
        same = self.is_current(target, _SAME_OBJECT_M) if same_object is None else same_object
        values = self.model.usable_values(reading, "touched")
        tdc = _checked_tdc(tdc, self.model)
        require_type(grasp, Grasp, "grasp", "not a Grasp, such as grasps[0]", GraspError)
        own = target.id if isinstance(target, Object) else ""
        if own != grasp.object_id and own.isdecimal() and grasp.object_id.isdecimal():  # in a scene, not a dataset
            raise GraspError(f"grasp: is on object {grasp.object_id}, not on {own}, the target")
        if estimate is None:
            estimate = self.model.estimate_executed(cloud, [grasp], table=table)
        else:
            estimate = Estimate.of(estimate, 1, self.model.sensor.channels.size)
        if not (same and self.touches):
            self.tracker.start_object(known=bool(estimate.known[0]))
        where = None if estimate.where is None else estimate.where[0]
        stamp_ns = time.time_ns() if stamp_ns is None else stamp_ns
        restarted = self.tracker.add_touch(stamp_ns, values, estimate.counts[0], tdc=tdc, where=where)
        self.signature = cloud.frame_id, place_and_size(cloud)
        self._tared = False
        return self._counted(restarted)

    @checked
    def predict(
        self,
        target: Cloud | Object,
        grasps: Sequence[Grasp],
        *,
        stamp_ns: int | None = None,
        same_object: bool | None = None,
    ) -> Predictions:
        """Predict the readings at each grasp, adapted to all readings so far.

        Args:
            target: The object, or its cloud.
            grasps: K grasps in the frame of its cloud.
            stamp_ns: Time of the predictions [ns]; now if None.
            same_object: Whether it is the object that was touched last; by default by place and size.

        Returns:
            A row for each grasp, as of `TouchModel.predict`. `reference` names the strongest reading that it was adapted to.

        Raises:
            CloudError: If the cloud cannot be used.
        """
        return self.model.predict(target, grasps, history=self.at(stamp_ns, target, same_object=same_object))

    def at(
        self,
        stamp_ns: int | None = None,
        target: Cloud | Object | None = None,
        *,
        same_object: bool | None = None,
        tared: bool | None = None,
        tdc: Float64 | None = None,
    ) -> Readings:
        """Return the readings so far, for predictions on an object at a time. Later readings do not change them.

        Args:
            stamp_ns: Time of the predictions [ns]; now if None.
            target: The object, or its cloud; None for the one that was touched last.
            same_object: Whether it is the one that was touched last; by default by place and size.
            tared: Whether a tare was taken shortly before; by default since the last touch.
            tdc: (F,) TDC at that time [counts]; where it is not known, the latest one counts.

        Raises:
            CloudError: If the target is neither an object nor a cloud.
            TactileError: If the stamp is no time, or the temperatures are not of the fingers.
        """
        require_type(same_object, bool | np.bool_ | None, "same_object", _NO_CHOICE, ModelError)
        require_type(tared, bool | np.bool_ | None, "tared", _NO_CHOICE, ModelError)
        if same_object is None:
            same_object = target is None or self.is_current(target, _SAME_OBJECT_M)
        return Readings(
            self.model,
            self.tracker.copy(),
            time.time_ns() if stamp_ns is None else checked_stamp(stamp_ns),
            same_object,
            self._tared if tared is None else tared,
            _checked_tdc(tdc, self.model),
        )

    def save(self, path: str | Path, hand: str = "") -> None:
        """Write everything read so far to a file.

        Args:
            path: The file, which is replaced.
            hand: Name of the hand.

        Raises:
            FileError: If it cannot be written; the one before is kept.
        """
        path = as_path(path)
        if not isinstance(hand, str) or hand != hand.encode(errors="replace").decode():
            raise FileError(path, f"hand: {shown(hand)} is not a name")
        content = pack_history(self.to_tensors(), hand, self.model.name, self.model.sensor.channels)
        replace_files({path: content})

    @classmethod
    def load(cls, path: str | Path, model: TouchModel, hand: str | None = None) -> Self:
        """Read what `save` wrote, or the file of a hand of the graph.

        Args:
            path: The file.
            model: The model of the history.
            hand: Name of the hand; None accepts any.

        Raises:
            FileError: If the file is absent or damaged, or of another version, sensor, hand or model.
            ModelError: If the model has no calibration.
        """
        require_type(model, TouchModel, "model", _NO_MODEL, ModelError)
        path = as_path(path)
        require_type(hand, str | None, "hand", "not a name", ModelError)
        model.new_tracker()  # a model without a calibration is named before the file
        tensors = unpack_history(path, hand, model.name, model.sensor.channels)
        try:
            return cls.from_tensors(model, tensors)
        except ModelError as err:
            raise FileError(path, str(err)) from err

    def keep_to_clock(self, now_ns: int) -> bool:
        """Count readings from the future of a clock [ns] as taken now (see `SensorTracker.keep_to_clock`)."""
        return self.tracker.keep_to_clock(now_ns)

    def is_current(self, target: Cloud | Object, same_object_m: float) -> bool:
        """Say whether an object is the one that was touched last, by its place and size.

        Args:
            target: The object, or its cloud [m].
            same_object_m: Largest difference of the mean and of the deviation of its points [m].

        Raises:
            CloudError: If the target is neither an object nor a cloud.
        """
        cloud, _ = _cloud_and_table(target)
        same_object_m = scalar(same_object_m, "same_object_m", ModelError)
        if self.signature is None or self.signature[0] != cloud.frame_id:
            return False
        with np.errstate(invalid="ignore"):  # of a cloud without points, which is equal to no other object
            return bool((np.abs(place_and_size(cloud) - self.signature[1]) <= same_object_m).all())

    def start_object(self) -> None:
        """Forget the touches of the last object, and keep the state of the sensors: another object is touched from now on."""
        self.tracker.start_object()
        self.signature = None

    def forget(self) -> int:
        """Forget everything, such as after the sensors were exchanged. Returns the number of readings that were forgotten."""
        count = self.tracker.evidence(0).readings
        self.tracker = self.model.new_tracker()
        self.signature, self._tare_ns = None, -1
        self._forgotten += 1
        return count

    @property
    def revision(self) -> tuple[int, int]:
        """Changes with every reading, object and `forget`."""
        return self._forgotten, self.tracker.revision

    def copy(self) -> Self:
        """Return an independent history of the same readings."""
        twin = type(self).__new__(type(self))
        vars(twin).update(vars(self), tracker=self.tracker.copy(), restarts=dict(self.restarts))
        return twin

    __copy__ = copy

    def to_tensors(self) -> dict[str, AnyArray]:
        """Return all of it as arrays, for a file."""
        frame, numbers = self.signature or ("", np.full(6, np.nan))
        own: dict[str, AnyArray] = {
            "signature": numbers,
            "frame": to_bytes(frame),
            "tare_ns": np.array([self._tare_ns], np.int64),
        }
        return {**own, **{_TRACKER + name: value for name, value in self.tracker.to_tensors().items()}}

    @classmethod
    def from_tensors(cls, model: TouchModel, tensors: Mapping[str, AnyArray]) -> Self:
        """Make a history from `to_tensors`. It goes on to the bit as the history that wrote it.

        Raises:
            ModelError: Names an array that is missing or cannot be, or if it is of another model.
        """
        history = cls(model)
        require_type(tensors, Mapping, "tensors", "not arrays by name, as of to_tensors()", ModelError)
        for name, shape, dtype in (("signature", (6,), np.float64), ("tare_ns", (1,), np.int64)):
            array = tensors.get(name)
            if array is None or array.shape != shape or array.dtype != dtype:
                raise ModelError(f"{name}: is missing, or of another shape or type")
        history.tracker = SensorTracker.from_tensors(history.tracker.parameters, under(_TRACKER, tensors))
        if history.touches:
            history.signature = to_text(tensors, "frame"), tensors["signature"]
        history._tare_ns = int(tensors["tare_ns"][0])
        return history

    def _counted(self, restarted: tuple[str, ...]) -> tuple[str, ...]:
        for finger in restarted:
            self.restarts[finger] = self.restarts.get(finger, 0) + 1
        return restarted


def _faults(grasps: Grasps, cloud: Cloud, max_width_m: float, max_distance_m: float) -> list[str]:
    """Return why no hand can execute each grasp; "" where one can."""
    return joined_faults(
        contact_faults(grasps.g1, grasps.g2, grasps.rotation),
        _absent_faults(grasps),
        reach_faults(grasps, cloud.xyz, max_width_m, max_distance_m),
        closing_faults(grasps),
    )


def _absent_faults(grasps: Grasps) -> list[str]:
    """Return of each grasp that its rotation is not given; "" where it is."""
    return fault_texts(~are_absent(grasps.rotation), lambda _: _NO_ROTATION)
