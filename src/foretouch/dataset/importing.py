# SPDX-License-Identifier: Apache-2.0
"""Makes recorded datasets out of what others recorded: vision2tactile folders, stores, any ROS bag with named topics.

Ids of samples are kept. A new dataset appears as a whole or not at all; an existing one of the same hand and camera
is added to. In a bag that holds no samples of ours, a touch is what the sensor read from contact to release of an
`ExecutedGrasp`, by header stamps (see `foretouch.dataset.pairing`); clouds whose grasps nobody executed become
unlabelled samples.
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
from foretouch.dataset.pairing.cut import DETECTOR, Interval, PairingConfig, PairingError, TouchCut, cut_touch
from foretouch.dataset.pairing.touch_buffer import TouchBuffer, TouchReading
from foretouch.dataset.recording.messages import SAMPLE_TYPE, decode_sample
from foretouch.dataset.recording.policy import RecordingConfig
from foretouch.dataset.recording.record import Identity, SampleRecord, TouchSeries
from foretouch.dataset.recording.writer import RecordingWriter
from foretouch.dataset.samples import is_sample_set, open_samples
from foretouch.errors import DatasetError, FileError, GraspError
from foretouch.types import ELECTRODES, Grasp, GraspSample

__all__ = ["BagTopics", "ImportResult", "import_samples"]

_CONFIG: Final = RecordingConfig(fsync_samples=0, fsync_s=0.0)  # the whole is waited for at the end
_NS: Final = 1_000_000_000
_KEPT_S: Final = 300.0  # of readings, for a grasp whose end is told of later
_LATE_NS: Final = _NS  # readings may come so much later than those of other topics
_OTHERS: Final = tuple(f"{channel}_{finger}" for finger in ("TH", "MF") for channel in ("PAC0", "PAC1", "TAC", "TDC"))


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
        pairing: How touch and tare are cut out of the readings, as in a live recording.
    """

    clouds: str = "/foretouch/object_cloud"
    grasps: str = "/foretouch/grasps"
    executed: str = "/foretouch/executed_grasp"
    tactile: str = "/rh/tactile"
    object: str = "unknown"
    fingers: tuple[int, int] = (4, 1)
    pairing: PairingConfig = PairingConfig()


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
        self._waiting: list[Any] = []
        self._touched: dict[str, tuple[Any, TouchCut | None]] = {}
        self._readings = TouchBuffer(kept_s=_KEPT_S, most=1_000_000)
        self._last_release_ns: int | None = None

    def records(self) -> Iterator[SampleRecord]:
        """The samples, in the order of their clouds."""
        self._require_topics()
        small = [self._topics.grasps, self._topics.executed, self._topics.tactile]
        take = dict(zip(small, (self._take_grasps, self._take_executed, self._take_reading), strict=True))
        for message in self._bag.messages(small):
            take[message.topic](self._bag.content(message))
        self._cut_waiting(everything=True)
        for _, cloud in self._bag.clouds(self._topics.clouds):
            grasps = self._grasps.pop(cloud.stamp_ns, [])
            if not grasps:
                self._left_out["cloud without grasps"] += 1
                continue
            executed = [grasp for grasp in grasps if grasp.id in self._touched]
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
        self._waiting.append(message)

    def _take_reading(self, message: Any) -> None:
        thumb, middle = (message.tactiles[place] for place in self._topics.fingers)
        if len(thumb.electrodes) != ELECTRODES or len(middle.electrodes) != ELECTRODES:
            self._left_out["reading without 24 electrodes"] += 1
            return
        counts = np.concatenate([[thumb.pdc, middle.pdc], thumb.electrodes, middle.electrodes])
        others = [value for one in (thumb, middle) for value in (one.pac0, one.pac1, one.tac, one.tdc)]
        stamp_ns = _ns(message.header.stamp)
        # When the bag received it says nothing of the sensor's clock: bags are also made offline.
        reading = TouchReading(stamp_ns, counts.astype(np.float32), np.array(others, np.float32), stamp_ns)
        self._readings.add(reading)
        self._cut_waiting(everything=False)

    def _cut_waiting(self, *, everything: bool) -> None:
        """Cut the touches of those grasps whose readings are all there."""
        newest = self._readings.newest_ns or 0
        ready = [m for m in self._waiting if everything or _ns(m.release) + _LATE_NS < newest]
        self._waiting = [m for m in self._waiting if m not in ready]
        for message in ready:
            interval = Interval(start=_ns(message.start), contact=_ns(message.contact), release=_ns(message.release))
            cut = None
            try:
                cut = cut_touch(self._readings, interval, self._topics.pairing, not_before_ns=self._last_release_ns)
            except PairingError as err:
                self._left_out[err.reason] += 1
            self._touched[message.grasp_id] = (message, cut)
            self._last_release_ns = interval.release

    def _labelled(self, record: SampleRecord) -> SampleRecord | None:
        """With the touch of its hold; None where the sensor says nothing that can be believed, which was counted."""
        executed, cut = self._touched[record.sample.grasp.id]
        if cut is None:
            return None
        stamp_ns = _ns(executed.contact)
        window = cut.window
        others = dict(zip(_OTHERS, window.others.T, strict=True))
        return replace(
            record,
            sample=replace(record.sample, touch=cut.touch, tare=cut.tare, stamp_ns=stamp_ns),
            outcome="success" if executed.success else "failure",
            series=TouchSeries(window.stamps_ns, window.counts, cut.phases, others),
            contact_ns=cut.contact_ns,
            detector=DETECTOR,
            pairing_error_ns=cut.error_ns,
            flags=cut.flags,
        )


def _grasp(message: Any) -> Grasp:
    g1, g2 = (np.array([point.x, point.y, point.z], np.float64) for point in (message.g1, message.g2))
    rotation = np.asarray(message.rotation, np.float64).reshape(3, 3)
    return Grasp(g1, g2, rotation, float(message.score), message.id, message.object_id)


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * _NS + int(stamp.nanosec)
