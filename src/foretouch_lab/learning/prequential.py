# SPDX-License-Identifier: Apache-2.0
"""Replay of recorded readings: each grasp is predicted from vision and all earlier readings [Dawid 1984].

This is what a robot at work sees. The tracker learns of another object wherever the name of the object changes, also
where an object returns: what was learned about it before is forgotten.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import DatasetError, GraspError, ModelError
from foretouch.models.calibration import tare_offset
from foretouch.models.touch_model import TouchModel
from foretouch.models.tracker import Level, SensorTracker
from foretouch.tactile import tdc_of
from foretouch.types import Bool, Float64, Index, Int64, Sample, Touch


@dataclass(frozen=True, eq=False)
class TimedReadings:
    """Readings of one hand in order of time, and predictions by vision that do not know them."""

    stamps_ns: Int64  # (S,) [ns], not decreasing
    objects: npt.NDArray[np.str_]  # (S,) names; another object begins wherever the name changes
    readings: Float64  # (S, D) [counts]
    expected: Float64  # (S, D) predictions by vision, at the rest level of training [counts]
    tares: Float64 | None = None  # (S, D) tare of each grasp minus the rest level, NaN without a tare [counts]
    known: Bool | None = None  # (S,) whether the object is like the training objects; None if unknown
    tdc: Float64 | None = None  # (S, F) TDC of the fingers with the reading, NaN without [counts]
    tare_tdc: Float64 | None = None  # (S, F) the same with the tare
    where: Float64 | None = None  # (S, P) features of the grasps, by which touches of one object are compared

    @classmethod
    def of_samples(
        cls, samples: Sequence[Sample], labels: Float64, expected: Float64, rest: Float64, known: Bool | None = None
    ) -> Self:
        """Take labelled samples with their predictions by vision.

        Args:
            samples: Labelled samples.
            labels: (S, D) their readings [counts].
            expected: (S, D) predictions by vision [counts].
            rest: (D,) level without contact [counts].
            known: (S,) whether each object is like the training objects.
        """
        tares = np.array([np.full(len(rest), np.nan) if s.tare is None else tare_offset(s.tare, rest) for s in samples])
        objects = np.array([sample.object for sample in samples], np.str_)
        stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
        read_as = [(sample.extra, sample.touch.channels) for sample in samples if sample.touch is not None]
        tdc, tare_tdc = (np.array([tdc_of(*reading, prefix) for reading in read_as]) for prefix in ("", "tare_"))
        read = {"tares": tares, "tdc": tdc, "tare_tdc": tare_tdc}
        some = {name: None if np.isnan(rows).all() else rows for name, rows in read.items()}
        return cls(stamps, objects, labels, expected, known=known, **some)

    def ordered(self) -> Self:
        """Return the readings in order of time; grasps of equal stamps keep their order.

        Raises:
            DatasetError: If there is no grasp, or one has no stamp.
        """
        if not len(self.stamps_ns) or self.stamps_ns.min() <= 0:
            raise DatasetError("prequential: there is no sample, or one has no stamp, so their order is not known")
        return self.take(np.argsort(self.stamps_ns, kind="stable"))

    def take(self, index: Index | Bool) -> Self:
        """Return some of the grasps, by indices or a mask."""
        arrays = {name: array[index] for name, array in vars(self).items() if array is not None}
        return replace(self, **arrays)

    def tare(self, k: int) -> Float64 | None:
        """Return (D,) tare of a grasp minus the rest level [counts]; None without."""
        return None if self.tares is None or np.isnan(self.tares[k]).all() else self.tares[k]

    def is_known(self, k: int) -> bool:
        """Return whether the object of a grasp is in the distribution of the training data."""
        return self.known is not None and bool(self.known[k])

    def tdc_before(self, k: int) -> Float64 | None:
        """Return (2,) temperature before a grasp: of its tare, else of its reading, since the hand knows it then [counts].

        The public recordings hold readings in contact alone, whose TDC the object may have changed.
        """
        tare = _row(self.tare_tdc, k)
        return _row(self.tdc, k) if tare is None or np.isnan(tare).all() else tare

    def begins(self) -> Bool:
        """Return (S,) whether another object than before is touched."""
        return np.concatenate([[True], self.objects[1:] != self.objects[:-1]])

    def runs(self) -> npt.NDArray[np.int_]:
        """Return (S,) number of the run of grasps on one object that a grasp belongs to."""
        return np.cumsum(self.begins()) - 1

    def touches(self) -> npt.NDArray[np.int_]:
        """Return (S,) touches of the object, since it was taken, before each grasp."""
        first = np.flatnonzero(self.begins())
        return np.arange(len(self.stamps_ns)) - first[self.runs()]


def _row(rows: Float64 | None, k: int) -> Float64 | None:
    return None if rows is None else rows[k]


def other_objects_mean(recording: TimedReadings) -> Float64:
    """Return (S, D) mean of all readings of other objects, earlier and later: the reference of the skill [counts].

    Raises:
        DatasetError: If all readings are of one object.
    """
    names = np.unique(recording.objects)
    if len(names) < 2:
        raise DatasetError(f"prequential: all readings are of {names[0]}; skills require another object")
    result = np.empty_like(recording.readings)
    for name in names:
        own = recording.objects == name
        result[own] = recording.readings[~own].mean(axis=0)
    return result


@dataclass(frozen=True, eq=False)
class Replayed:
    """Predictions of each grasp from all that was read before it."""

    counts: Float64  # (S, D) [counts]
    half: Float64  # (S, D) half widths of the 90 % intervals [counts]
    deviation: Float64  # (S, D) predicted standard deviations of the readings [counts]
    levels: list[Level]  # (S,) levels of the tracker
    restarted: list[tuple[str, ...]]  # (S,) fingers that each reading restarted


def replay(tracker: SensorTracker, recording: TimedReadings, *, keep_sensors: bool = True) -> Replayed:
    """Predict each grasp, then add its reading to the tracker; one that is NaN is only predicted.

    Args:
        tracker: With its history so far, which is continued.
        recording: In order of time, and after that history.
        keep_sensors: Whether the state of the sensors is kept at another object; else everything ends with the object.

    Raises:
        TactileError: If a reading or a stamp cannot be used.
    """
    counts, half, deviation = np.empty((3, *recording.readings.shape))
    levels, restarted = [], []
    begins = recording.begins()
    for k, (stamp, reading, expected) in enumerate(
        zip(recording.stamps_ns.tolist(), recording.readings, recording.expected, strict=True)
    ):
        if begins[k]:
            tracker = tracker if keep_sensors else SensorTracker(tracker.parameters)
            tracker.start_object(known=recording.is_known(k))
        names: tuple[str, ...] = ()
        if (tare := recording.tare(k)) is not None:
            names = tracker.add_tare(stamp, tare, tdc=_row(recording.tare_tdc, k))
        levels.append(tracker.level(stamp, tdc=recording.tdc_before(k)))
        where = _row(recording.where, k)
        (counts[k],), (variance,) = tracker.moments(levels[k], expected[None], None if where is None else where[None])
        deviation[k] = np.sqrt(variance)
        half[k] = tracker.factor(levels[k]) * deviation[k]
        if not np.isnan(reading).all():
            names += tracker.add_touch(stamp, reading, expected, tdc=_row(recording.tdc, k), where=where)
        restarted.append(tuple(dict.fromkeys(names)))
    return Replayed(counts, half, deviation, levels, restarted)


@dataclass(frozen=True, eq=False)
class ModelReplay:
    """Replay of samples by a model, in order of time."""

    samples: list[Sample]  # S of them
    recording: TimedReadings  # readings of unlabelled samples are NaN
    played: Replayed
    scored: Bool  # (S,) False for samples of the history


def replay_model(model: TouchModel, samples: Sequence[Sample], history: Sequence[Sample] = ()) -> ModelReplay:
    """Predict each sample by a model from vision and all that was read before it.

    Args:
        model: With a calibration.
        samples: To predict; their readings are added, too.
        history: Further readings of the same sensors, of any object; samples that are also to predict are ignored.

    Raises:
        DatasetError: If there is no sample, or one has no stamp.
        ModelError: If the model has no calibration, or cannot predict a sample.
        TactileError: Names the sample whose reading is of another sensor, or no working one can have given.
    """
    if model.calibration is None:
        raise ModelError(f"{model.name}: cannot remember readings: its card holds no calibration")
    own = {(sample.id, sample.stamp_ns) for sample in samples}
    earlier = [sample for sample in history if (sample.id, sample.stamp_ns) not in own]
    flagged = [(sample, True) for sample in samples] + [(sample, False) for sample in earlier]
    flagged.sort(key=lambda pair: pair[0].stamp_ns)
    ordered = [sample for sample, _ in flagged]
    readings, expected = np.full((2, len(ordered), model.sensor.channels.size), np.nan)
    known, where = np.zeros(len(ordered), np.bool_), []
    for k, sample in enumerate(ordered):
        if sample.touch is not None:
            readings[k] = model.usable_values(sample.touch, sample.id)
        if sample.tare is not None:
            tare = Touch(model.usable_values(sample.tare, sample.id), sample.tare.channels)
            ordered[k] = with_readings(sample, tare=tare)
        try:
            estimate = model.estimate_executed(sample.cloud, [sample.grasp], table=sample.table)
        except GraspError as err:
            raise ModelError(f"{sample.id}: {err}") from err
        expected[k], known[k] = estimate.counts[0], estimate.known[0]
        where.append(estimate.where)
    recording = TimedReadings.of_samples(ordered, readings, expected, model.calibration.rest, known).ordered()
    described = [features for features in where if features is not None]
    recording = replace(recording, where=np.concatenate(described)) if len(described) == len(where) else recording
    played = replay(SensorTracker(model.calibration.tracker_parameters), recording)
    return ModelReplay(ordered, recording, played, np.array([mine for _, mine in flagged], np.bool_))


def with_readings(sample: Sample, **readings: Touch) -> Sample:
    """Return the sample with another `touch` or `tare`; its cloud is not read."""
    changed = copy.copy(sample)
    vars(changed).update(readings)
    return changed
