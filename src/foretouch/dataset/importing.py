# SPDX-License-Identifier: Apache-2.0
"""Makes recorded datasets out of what others recorded: vision2tactile folders, stores, any ROS bag with named topics.

Ids of samples are kept. A new dataset appears as a whole or not at all; an existing one of the same hand and camera
is added to. In a bag that holds no samples of ours, a touch is what the sensor read from contact to release of an
`ExecutedGrasp`, by header stamps; clouds whose grasps nobody executed become unlabelled samples.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.bag import Recording, is_recording
from foretouch.dataset.recording.messages import SAMPLE_TYPE, decode_sample
from foretouch.dataset.recording.record import HOLD, REST, Identity, SampleRecord, TouchSeries
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import is_sample_set, open_samples
from foretouch.errors import DatasetError, FileError, ForetouchError, GraspError
from foretouch.tactile.tare import make_tare
from foretouch.tactile.validity import check_touch
from foretouch.types import Float64, Grasp, GraspSample, Touch

__all__ = ["BagTopics", "ImportResult", "import_samples"]

_CONFIG: Final = RecordingConfig(fsync_samples=0, fsync_s=0.0)  # the whole is waited for at the end
_NS: Final = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class BagTopics:
    """Which topic of a bag holds what, and how it is read.

    Attributes:
        clouds: `sensor_msgs/PointCloud2` of the object alone.
        grasps: `foretouch_msgs/GraspArray`, each with the stamp of its cloud.
        executed: `foretouch_msgs/ExecutedGrasp`.
        tactile: `foretouch_msgs/BiotacAll` or `sr_robot_msgs/BiotacAll`.
        object: Label of the object on the table.
        fingers: Places of thumb and middle finger in `tactiles`.
        tolerance_ns: Longest gap between readings within a hold, and at its ends [ns].
        rest_ns: How long before the start of a grasp its tare is taken [ns].
    """

    clouds: str = "/foretouch/object_cloud"
    grasps: str = "/foretouch/grasps"
    executed: str = "/foretouch/executed_grasp"
    tactile: str = "/rh/tactile"
    object: str = "unknown"
    fingers: tuple[int, int] = (4, 1)
    tolerance_ns: int = 50_000_000
    rest_ns: int = _NS


@dataclass(kw_only=True)
class ImportResult:
    """What became of it.

    Attributes:
        samples: Samples in the dataset that came from here.
        labelled: Those with a touch.
        left_out: What was not taken, by reason.
    """

    samples: int = 0
    labelled: int = 0
    left_out: Counter[str] = field(default_factory=Counter)


def import_samples(
    source: str | Path,
    out: str | Path,
    *,
    identity: Identity | None = None,
    topics: BagTopics | None = None,
    progress: Callable[[], None] = lambda: None,
) -> ImportResult:
    """Import whatever lies at a path.

    Args:
        source: Vision2tactile folders, a store, a recorded dataset, or a bag.
        out: The dataset: made, or added to where it is of the same hand and camera.
        identity: Hand and camera; needed where the source does not tell them.
        topics: Of a bag that holds no samples of ours.
        progress: Called once a sample.

    Raises:
        FileError: If the source is damaged or holds nothing of the kind, or the dataset is of another kind.
        DatasetError: If an id is taken.
    """
    source, out = Path(source), Path(out)
    result = ImportResult()
    if is_sample_set(source):
        with open_samples(source) as samples:
            known = identity or samples.identity
            _write(out, known, samples.records(discarded=True), result, progress)
        return result
    if not is_recording(source):
        rule = "holds no samples and is no recording" if source.exists() else "does not exist"
        raise FileError(source, rule)
    with Recording(source) as bag:
        holding = [topic.name for topic in bag.topics if topic.type == SAMPLE_TYPE]
        if holding:
            told, records = _own_samples(bag, holding)
            _write(out, identity or told, records, result, progress)
            return result
        unknown = Identity(hand={"name": "unknown"}, camera={"name": "unknown"})
        records = _BagImport(bag, topics or BagTopics(), result).records()
        _write(out, identity or unknown, records, result, progress)
    return result


def _write(
    out: Path, identity: Identity, records: Iterable[SampleRecord], result: ImportResult, progress: Callable[[], None]
) -> None:
    """Into the dataset; a new one is made beside its place and moved there."""
    adding = out.exists()
    place = out if adding else out.with_name(f".{out.name}.part")
    if not adding:
        shutil.rmtree(place, ignore_errors=True)
    try:
        with RecordingWriter(place, identity, _CONFIG) as writer:
            for record in records:
                writer.append(record)
                result.samples += 1
                result.labelled += record.sample.touch is not None
                progress()
        if not adding:
            place.rename(out)
    except OSError as err:
        raise FileError(out, f"{err.strerror or err} (errno {err.errno})") from err
    finally:
        if not adding:
            shutil.rmtree(place, ignore_errors=True)


def _own_samples(bag: Recording, topics: list[str]) -> tuple[Identity, Iterator[SampleRecord]]:
    messages = bag.messages(topics)
    first = next(messages, None)
    if first is None:
        return Identity(hand={}, camera={}), iter(())

    def records() -> Iterator[SampleRecord]:
        for message in bag.messages(topics):
            try:
                yield decode_sample(message.data).record
            except DatasetError as err:
                raise FileError(bag.path, str(err), field=f"{message.topic}[{message.index}]") from err

    return decode_sample(first.data).identity, records()


class _BagImport:
    """Joins clouds, grasps, executions and readings of a bag: twice through, so that no cloud has to be remembered."""

    def __init__(self, bag: Recording, topics: BagTopics, result: ImportResult) -> None:
        self._bag = bag
        self._topics = topics
        self._left_out = result.left_out
        self._grasps: dict[int, list[Grasp]] = {}
        self._executed: dict[str, Any] = {}
        self._stamps: list[int] = []
        self._readings: list[Float64] = []

    def records(self) -> Iterator[SampleRecord]:
        """The samples, in the order of their clouds."""
        self._require_topics()
        small = [self._topics.grasps, self._topics.executed, self._topics.tactile]
        take = dict(zip(small, (self._take_grasps, self._take_executed, self._take_reading), strict=True))
        for message in self._bag.messages(small):
            take[message.topic](self._bag.content(message))
        order = np.argsort(np.asarray(self._stamps, np.int64), kind="stable")
        self._sorted_ns = np.asarray(self._stamps, np.int64)[order]
        self._sorted = np.asarray(self._readings, np.float64).reshape(-1, 50)[order]
        for _, cloud in self._bag.clouds(self._topics.clouds):
            grasps = self._grasps.pop(cloud.stamp_ns, [])
            if not grasps:
                self._left_out["cloud without grasps"] += 1
                continue
            executed = [grasp for grasp in grasps if grasp.id in self._executed]
            for grasp in executed or grasps[:1]:
                sample = GraspSample("", self._topics.object, cloud, grasp, stamp_ns=cloud.stamp_ns)
                others = tuple(other for other in grasps if other is not grasp)
                record = SampleRecord(sample=sample, candidates=others)
                labelled = self._labelled(record) if executed else record
                if labelled is not None:
                    yield labelled
        self._left_out["grasps without their cloud"] += len(self._grasps)

    def _require_topics(self) -> None:
        known = {topic.name: topic.type for topic in self._bag.topics}
        for name in (self._topics.clouds, self._topics.grasps):
            if name not in known:
                told = ", ".join(sorted(known)) or "none"
                raise FileError(self._bag.path, f"no such topic; known: {told}", field=name)

    def _take_grasps(self, message: Any) -> None:
        stamp_ns = _ns(message.header.stamp)
        for one in message.grasps:
            try:
                self._grasps.setdefault(stamp_ns, []).append(_grasp(one))
            except GraspError:
                self._left_out["bad grasp"] += 1

    def _take_executed(self, message: Any) -> None:
        self._executed[message.grasp_id] = message

    def _take_reading(self, message: Any) -> None:
        thumb, middle = (message.tactiles[place] for place in self._topics.fingers)
        if len(thumb.electrodes) != 24 or len(middle.electrodes) != 24:
            self._left_out["reading without 24 electrodes"] += 1
            return
        self._stamps.append(_ns(message.header.stamp))
        values = [[thumb.pdc, middle.pdc], thumb.electrodes, middle.electrodes]
        self._readings.append(np.concatenate(values).astype(np.float64))

    def _labelled(self, record: SampleRecord) -> SampleRecord | None:
        """With the touch of its hold; None, and counted, where the sensor says nothing that can be believed."""
        executed = self._executed[record.sample.grasp.id]
        start, contact, release = map(_ns, (executed.start, executed.contact, executed.release))
        first, last = np.searchsorted(self._sorted_ns, [contact, release + 1])
        hold = self._sorted_ns[first:last]
        edges = np.concatenate([[contact], hold, [release]])
        gap = int(np.diff(edges).max()) if len(hold) else release - contact
        if len(hold) == 0 or gap > self._topics.tolerance_ns:
            self._left_out["no readings in the hold" if len(hold) == 0 else "gap in the readings of the hold"] += 1
            return None
        touch = Touch.from_vector(np.median(self._sorted[first:last], axis=0))
        if not check_touch(touch).valid:
            self._left_out["absent or dead sensor"] += 1
            return None
        begin, rest = np.searchsorted(self._sorted_ns, [start - self._topics.rest_ns, start])
        sample = replace(record.sample, touch=touch, tare=self._tare(begin, rest), stamp_ns=contact)
        return replace(
            record,
            sample=sample,
            outcome="success" if executed.success else "failure",
            series=self._series(begin, last, start, contact),
            contact_ns=contact,
            detector="executed_grasp",
            pairing_error_ns=gap,
        )

    def _tare(self, first: int, last: int) -> Touch | None:
        try:
            return make_tare([Touch.from_vector(row) for row in self._sorted[first:last]])
        except ForetouchError:
            return None

    def _series(self, first: int, last: int, start_ns: int, contact_ns: int) -> TouchSeries:
        stamps = self._sorted_ns[first:last]
        phases = (stamps >= start_ns).astype(np.uint8) + (stamps >= contact_ns).astype(np.uint8)
        return TouchSeries(stamps, self._sorted[first:last].astype(np.float32), np.clip(phases, REST, HOLD))


def _grasp(message: Any) -> Grasp:
    g1, g2 = (np.array([point.x, point.y, point.z], np.float64) for point in (message.g1, message.g2))
    rotation = np.asarray(message.rotation, np.float64).reshape(3, 3)
    return Grasp(g1, g2, rotation, float(message.score), message.id, message.object_id)


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * _NS + int(stamp.nanosec)
