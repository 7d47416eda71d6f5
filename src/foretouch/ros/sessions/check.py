# SPDX-License-Identifier: Apache-2.0
"""Checks hand, camera and table before a recording session, from the messages that the recorder receives, and records nothing.

Each finding is one line with a fix. The reports of a dataset are lines of `checks.jsonl` beside its recordings.
"""

import json
import math
import os
import time
from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch import __version__
from foretouch.base.files import open_own, system_errors
from foretouch.cloud.io.depth_messages import CameraInfos
from foretouch.cloud.messages import decode_cloud, decode_objects, decode_plane, read_header
from foretouch.dataset.labelling.sensors import ALIVE, NO_DATA, SensorHealth
from foretouch.errors import ForetouchError
from foretouch.ros.messages.requests import read_serialized
from foretouch.ros.runtime.subscription import SerializedMessage
from foretouch.ros.sessions.subscriptions import MessageQueue, RecorderInputs
from foretouch.tactile.channels import finger_label
from foretouch.tactile.contact_detector import ContactDetector, contact_scores
from foretouch.tactile.messages.table import TactileReader, TactileReading
from foretouch.tactile.readings import is_tdc, to_celsius
from foretouch.types import Cloud, Float32, Float64, Index, Plane
from foretouch_msgs.msg import TablePlane

CHECKS: Final = "checks.jsonl"
_HAND_SHARE: Final = 0.5  # least rate of the tactile messages, as a share of the sensor's own
_CAMERA_HZ: Final = 10.0  # least rate of the clouds [Hz]
_HAND_OFFSET_S: Final = 0.1  # largest offset of the hand's clock [s]: `guard_s` of the pairing
_CAMERA_OFFSET_S: Final = 0.5  # largest delay of the clouds [s], which includes their computation
_CELSIUS: Final = (10.0, 60.0)  # of a working finger
_NEAR_M: Final = 0.3  # how far from the object the hand is looked for
_ABOVE_M: Final = 0.03  # above the table
_POINTS: Final = 200  # of what is taken for a hand
_IMAGES = (Image, CompressedImage)
_QUEUE_BYTES = 500_000_000
_CLOUDS = 5  # of the camera that are kept until the object's cloud of the same stamp comes


class CheckFinding(NamedTuple):
    """The result of one check; with a fix, it is a fault."""

    name: str  # what was checked
    found: str
    fix: str = ""

    def record(self) -> dict[str, Any]:
        """Return the finding as it is stored and printed."""
        return {"name": self.name, "fault": bool(self.fix), "found": self.found, "fix": self.fix}


class SessionCheck:
    """Collects messages for a while, then reports; not thread-safe.

    Args:
        fingers: Names of both fingers in the tactile messages.
        reader: Of these messages.

    Attributes:
        pressed: Fingers that were in contact, in order.
        table: Plane of the table in the latest message; None without one.
        scene, targets: Points of the camera, and (N, 3) of each object that was found in them [m].
    """

    def __init__(self, fingers: Sequence[str], reader: TactileReader) -> None:
        self.pressed: list[str] = []
        self.table: Plane | None = None
        self.scene: Float32 | None = None
        self.targets: Sequence[Float32] = ()
        self._reader, self._channels = reader, reader.channels
        self._fingers = dict(zip(reader.channels.fingers, fingers, strict=True))
        self._contacts, self._health = ContactDetector(reader.channels), SensorHealth(reader.channels)
        self._readings: deque[TactileReading] = deque(maxlen=2000)
        self._received: dict[str, list[int]] = defaultdict(list)
        self._behind: dict[str, list[int]] = defaultdict(list)
        self._answers: dict[str, tuple[str, ...]] = {}
        self._unreadable: Counter[str] = (
            Counter()
        )  # messages that could not be decoded, by the last part of their topic
        self._fault = ""  # why the latest was none

    def add_message(self, what: str, received_ns: int, stamp_ns: int | None) -> None:
        """Count a message of the `hand` or the `camera`, with its stamp if it has one [ns]."""
        self._received[what].append(received_ns)
        if stamp_ns is not None:
            self._behind[what].append(received_ns - stamp_ns)

    def add_reading(self, reading: TactileReading, received_ns: int) -> None:
        """Add a tactile reading; one in which a finger was not read shows only that."""
        self.add_message("hand", received_ns, reading.stamp_ns)
        self._health.update(reading.counts)
        if np.isnan(reading.counts).any():
            return
        self._readings.append(reading)
        events = self._contacts.update(received_ns, reading.counts)
        self.pressed += [event.finger for event in events if event.kind == "onset"]

    def add_unreadable(self, topic: str, reason: str) -> None:
        """Count a message that could not be decoded."""
        self._unreadable[topic.rpartition("/")[2]] += 1
        self._fault = reason

    def end_press(self, finger: str) -> None:
        """Take what is `pressed` for the answer to the press of a finger, such as `TH`."""
        self._answers[finger] = tuple(dict.fromkeys(self.pressed))

    def at_rest(self) -> list[CheckFinding]:
        """Return what the messages so far show, while nothing was to be touched."""
        findings = [
            self._rate(
                "hand",
                _HAND_SHARE * self._reader.sensor.config.update_rate,
                "is the driver running, and tactile_topic its topic? Else lower the computer's load",
            ),
            self._clock("hand", _HAND_OFFSET_S),
            self._rate("camera", _CAMERA_HZ, "raise its frame rate, or lower its resolution or the computer's load"),
            self._clock("camera", _CAMERA_OFFSET_S),
            *self._fingers_at_rest(),
        ]
        if self._unreadable:
            counts = ", ".join(f"{count} of {topic}" for topic, count in self._unreadable.items())
            wrong = "do the types and the sensor's description fit?"
            findings.append(CheckFinding("messages", f"cannot be decoded: {counts}: {self._fault}", wrong))
        table = CheckFinding("table", "found")
        if self.table is None:
            fix = "is the graph running, and the table in the camera's view?"
            table = CheckFinding("table", "none in the clouds", fix)
        return [*findings, table, self._view()]

    def presses(self) -> list[CheckFinding]:
        """Return whether each pressed finger has answered."""
        findings = []
        for finger, answers in self._answers.items():
            first, second = self._fingers.values()
            other = next(name for name in self._fingers if name != finger)
            text, fix = f"{' and '.join(answers) or 'no finger'} answered", ""
            if answers == (other,):
                fix = f"fingers are swapped: --thumb {second} --middle {first}"
            elif answers != (finger,):
                fix = "press one finger alone, on its pad; else check its cable" if answers else "check its cable"
            findings.append(CheckFinding(f"press {finger_label(finger)}", text, fix))
        return findings

    def _rate(self, what: str, least_hz: float, fix: str) -> CheckFinding:
        times = [time for received in self._received.values() for time in received]
        rate = len(self._received[what]) / max(1e-9 * (max(times) - min(times)), 1.0) if times else 0.0
        if rate < least_hz:
            return CheckFinding(f"{what} rate", f"{rate:.1f} Hz, at least {least_hz:g} are needed", fix)
        return CheckFinding(f"{what} rate", f"{rate:.1f} Hz")

    def _clock(self, what: str, most_s: float) -> CheckFinding:
        if not self._behind[what]:
            return CheckFinding(f"{what} clock", "there are no messages with a stamp")
        offset = min(self._behind[what]) * 1e-9
        text = f"{abs(offset):.2f} s {'behind' if offset > 0.0 else 'ahead of'} this computer"
        if abs(offset) <= most_s:
            return CheckFinding(f"{what} clock", text)
        load = ", or reduce the load" if offset > 0.0 else ""
        return CheckFinding(f"{what} clock", text, f"synchronise the clocks (chrony, PTP){load}")

    def _fingers_at_rest(self) -> list[CheckFinding]:
        channels = self._channels
        counts = np.array([reading.counts for reading in self._readings], np.float64).reshape(-1, channels.size)
        half = len(counts) // 2
        scores = contact_scores(counts[half:], counts[:half], channels) if half > 4 else np.zeros((1, 2))
        restless = np.median(scores, axis=0) > 1.0
        findings: list[CheckFinding] = []
        for k, (finger, columns) in enumerate(channels.finger_columns.items()):
            state, fix = self._health.states[finger], "check cable and power of the finger"
            if not half and state in (ALIVE, NO_DATA):
                state = "no readings"
            still = self._still(counts, columns) if half else ()
            if state == ALIVE and len(still):
                state = f"taxels {', '.join(map(str, still))} (the first is 0) never change"
            elif state == ALIVE and restless[k]:
                state, fix = "is touched: no tare", "keep the fingers open and still"
            findings.append(CheckFinding(finger_label(finger), state, "" if state == ALIVE else fix))
        return [*findings, *self._temperatures()]

    def _still(self, counts: Float64, columns: Index) -> Index:
        """Return the indices of the taxels of which no value has changed; forces at rest may be zero for any time."""
        moved = (counts[:, columns] != counts[:1, columns]).any(axis=0) | ~self._channels.tared[columns]
        values, size = sum(value.predicted for value in self._reader.sensor.config.values), self._reader.sensor.size
        return np.flatnonzero(~moved[len(moved) - values * size :].reshape(values, size).any(axis=0))

    def _temperatures(self) -> Iterator[CheckFinding]:
        """Check the temperatures of the fingers that send one."""
        others = self._reader.others
        for finger in self._channels.fingers if self._readings else ():
            if (channel := f"TDC_{finger}") not in others:
                continue
            tdc = float(np.median([reading.others[others.index(channel)] for reading in self._readings]))
            celsius = to_celsius(tdc) if is_tdc(np.array([tdc]))[0] else None
            text = f"TDC is {tdc:g}: the driver sends none" if celsius is None else f"{celsius:.1f} °C"
            low, high = _CELSIUS
            odd = celsius is not None and not low <= celsius <= high
            fix = f"{low:g} to {high:g} are plausible: let it warm up or cool down, or check the finger" if odd else ""
            yield CheckFinding(f"{finger_label(finger)} temperature", text, fix)

    def _view(self) -> CheckFinding:
        """Return whether the hand, or another thing, stands where the object is."""
        name = "hand in view"
        if self.table is None or self.scene is None or not self.targets:
            fix = "lay an object on the table and start the graph (foretouch run, or perception.launch.py)"
            return CheckFinding(name, "no object was found, so this is not known", fix)
        gap_m = _nearest_other(self.scene, self.targets, self.table)
        if gap_m >= _NEAR_M:
            return CheckFinding(name, "no")
        fix = "move the hand and other things aside while the camera looks"
        return CheckFinding(name, f"something stands {100.0 * gap_m:.0f} cm from the object", fix)


def _nearest_other(scene: Float32, targets: Sequence[Float32], table: Plane) -> float:
    """Return the distance from the first object to what else stands on or above the table near it [m]; infinite if nothing."""
    points: Float64 = scene.reshape(-1, 3)[np.isfinite(scene.reshape(-1, 3)).all(axis=1)].astype(np.float64)
    height = points @ table.normal + table.offset
    other = points[(height > _ABOVE_M) & (height < 2.0 * _NEAR_M)]
    for target in targets:
        low, high = target.min(axis=0) - 0.02, target.max(axis=0) + 0.02
        other = other[~((other > low) & (other < high)).all(axis=1)]
    across = other - targets[0].mean(axis=0)
    across -= (across @ table.normal)[:, None] * table.normal
    distances = np.sort(np.linalg.norm(across, axis=1))
    return float(distances[_POINTS]) if len(distances) > _POINTS else math.inf


def store_check(path: Path, findings: Sequence[CheckFinding], stamp_ns: int) -> None:
    """Append a report to the reports of a dataset; the caller holds the lock. Raises a `FileError` if it cannot be written.

    Args:
        path: The dataset.
        findings: What was found.
        stamp_ns: Time of the check [ns].
    """
    report = {"stamp_ns": stamp_ns, "foretouch": __version__, "findings": [finding.record() for finding in findings]}
    with system_errors(path / CHECKS), os.fdopen(open_own(path / CHECKS, os.O_WRONLY | os.O_APPEND), "ab") as log:
        log.write((json.dumps(report, ensure_ascii=False) + "\n").encode())
        log.flush()
        os.fsync(log.fileno())


class CheckFeed:
    """Receives until `close`; messages that cannot be decoded are counted.

    Args:
        check: Gets the messages.
        inputs: What is received.
        reader: Of the hand's messages.
    """

    def __init__(self, check: SessionCheck, inputs: RecorderInputs, reader: TactileReader) -> None:
        self._check = check
        self._inputs = inputs
        self._reader = reader
        self._clouds: OrderedDict[int, SerializedMessage] = OrderedDict()  # or depth images
        images = (name for name, topic in inputs.topics.items() if topic.message in _IMAGES)
        self._infos = CameraInfos(next(images, ""))
        self._queue = MessageQueue(_QUEUE_BYTES)
        inputs.open(self._queue)

    def receive(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Give messages to the check.

        Args:
            seconds: For how long [s].
            done: Ends it before, once it is true.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end and not done():
            for message in self._queue.take(0.05)[0]:
                try:
                    self._add(message)
                except ForetouchError as err:
                    self._check.add_unreadable(message.topic, str(err))

    def close(self) -> None:
        """Receive no more."""
        self._inputs.close()

    def _add(self, message: SerializedMessage) -> None:
        topic, check = self._inputs.topics[message.topic], self._check
        match topic.role:
            case "info":
                self._infos.add(read_serialized(message.data, CameraInfo), time.monotonic())
            case "scene":
                stamp, _ = read_header(message.data)
                check.add_message("camera", message.received_ns, stamp)
                self._clouds[stamp] = message
                if len(self._clouds) > _CLOUDS:
                    self._clouds.popitem(last=False)
            case "table":
                check.table = decode_plane(read_serialized(message.data, TablePlane).plane)
            case "cloud":
                scene = self._clouds.get(read_header(message.data)[0])
                objects = decode_objects(read_serialized(message.data, PointCloud2))
                if scene is not None and objects:
                    check.scene = self._scene(scene).xyz
                    check.targets = [object_.cloud.xyz for object_ in objects]
            case "tactile":
                reading = self._reader.read(read_serialized(message.data, topic.message))
                check.add_reading(reading, message.received_ns)

    def _scene(self, message: SerializedMessage) -> Cloud:
        kind = self._inputs.topics[message.topic].message
        content: Any = read_serialized(message.data, kind)
        return self._infos.cloud(content, time.monotonic()) if kind in _IMAGES else decode_cloud(content)
