# SPDX-License-Identifier: Apache-2.0
"""Plays a recording, a folder or a file into the graph in place of a camera.

Threads: one thread reads ahead by one message, waits until it is due and publishes it; the executor's
callbacks only note answers. Messages of a recording are published byte for byte as they were recorded,
unless `restamp` is set. Its other topics are played too, where this machine has their types.

/diagnostics reports the state of the replay, `replay`: `waiting`, `playing`, then `finished`, `stopped` or `failed`, and the
counts. Depth images keep the name of their topic, and their camera infos are beside them. In the same process, `ReplayNode.ended` is set at the end.
"""

import math
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ament_index_python import has_resource
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.cloud.messages import decode_cloud, read_header, with_stamp
from foretouch.config import setting
from foretouch.dataset.recordings.bag import Topic
from foretouch.dataset.source import Source, open_source
from foretouch.errors import ConfigError, MissingDependencyError
from foretouch.ros.messages.conversions import header_to_msg, plane_to_msg
from foretouch.ros.messages.requests import read_serialized
from foretouch.ros.messages.tactile import message_class
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.discovery import ends_of_topics, is_heard_outside
from foretouch.ros.runtime.lifecycle_node import NodeConfig, ThreadNode
from foretouch.ros.sessions.playlist import CLOUDS, Entry, Pace, cloud_is_object, entries
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC
from foretouch.types import Plane, assumed_table, stamp_ns
from foretouch_msgs.msg import Status, TablePlane, TouchPredictionArray

_DEPTH = 100  # messages that a slow reliable subscriber may lag behind
_POLL_S = 0.05
_ANSWER_S = 5.0  # longest wait for an answer in lockstep
_TOGETHER_NS = 1_000_000_000  # within which a depth image and its colours are published
_FRAME = "camera_depth_optical_frame"  # of clouds from files that name none


def playable(topics: Iterable[Topic], namespace: str) -> tuple[dict[Topic, type], dict[str, str]]:
    """Find the message class of each topic of a recording that can be played, and the reason for each other with messages.

    Args:
        topics: Of the recording.
        namespace: Of the graph: what its nodes published then must not be mixed with what they publish now.
    """
    classes: dict[Topic, type] = {}
    reasons: dict[str, str] = {}
    prefix = namespace.rstrip("/") + "/"
    for topic in topics:
        if topic.name in {"/diagnostics", "/parameter_events", "/rosout"}:
            kind: type | str = "reports on running nodes"
        elif topic.name.startswith(prefix) and topic.name != prefix + EXECUTED_TOPIC:  # which the robot publishes
            kind = f"this graph publishes under {namespace} itself"
        else:
            kind = _message_class(topic)
        if topic.count and isinstance(kind, type):
            classes[topic] = kind
        elif topic.count:
            reasons[topic.name] = f"{kind} ({topic.count} messages)"
    return classes, reasons


def _message_class(topic: Topic) -> type | str:
    """Import the class of a topic's messages if this machine has it with the same fields; else give the reason."""
    if re.fullmatch(r"[a-z]\w*/msg/[A-Z]\w*", topic.type) is None:
        return f"type {topic.type or 'mixed'} is not a message type"
    # A recording may name any module: only what is installed as ROS interfaces is imported.
    absent = f"type {topic.type} is not installed"
    if not has_resource("rosidl_interfaces", topic.type.partition("/")[0]):
        return absent
    try:
        kind = message_class(topic.type)
    except MissingDependencyError:
        return absent
    fields = tuple(cast("Any", kind).get_fields_and_field_types())
    if tuple(field.lower() for field in topic.fields) != fields:  # some names of ROS 1 had capitals
        return f"type {topic.type} had other fields when it was recorded"
    return kind


@dataclass(frozen=True, kw_only=True)
class ReplayConfig(NodeConfig):
    """Settings of the replay."""

    path: str = setting("", "Recording, folder of clouds or samples, or file", read_only=True)
    topic: str = setting("", "Topic of the clouds, for a recording that holds several", read_only=True)
    intrinsics: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0, 0.0), "fx, fy, cx, cy of depth images; zeros take their own camera", unit="px", read_only=True
    )
    camera_info: str = setting("", "File with the camera of depth images; empty: their own", read_only=True)
    info_topic: str = setting(
        "",
        "Topic of the camera infos of a recording; empty: `camera_info` beside, or the only one that fits",
        read_only=True,
    )
    rectified: str = setting(
        "",
        "Whether depth images are rectified, so that P of their camera describes them; empty: by their name",
        choices=("", "yes", "no"),
        read_only=True,
    )
    depth_scale: float = setting(
        0.0, "Metres per unit of depth images; 0: their own", bounds=(0.0, 1.0), read_only=True
    )
    color: str = setting(
        "",
        "Colours of depth images: the file of a single image, or a topic of a recording. If it is empty, they are those in the file or folder, or the topic that fits",
        read_only=True,
    )
    table: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0, 0.0),
        "a, b, c, d of the plane published with `object_cloud`; zeros: below a camera that looks straight down, at the farthest point",
        read_only=True,
    )
    rate_hz: float = setting(
        0.0, "Clouds per second; 0 keeps the recorded times, and plays files at 10 Hz", bounds=(0.0, 1000.0)
    )
    longest_pause_s: float = setting(
        10.0, "Longer pauses of a recording, as where its clock was set, are cut to this", bounds=(0.0, 86400.0)
    )
    loop: bool = setting(False, "Start again at the end, with increasing stamps")
    restamp: bool = setting(False, "Stamp every message with the time of its publication")
    lockstep: bool = setting(False, "Publish each cloud after the answer on `touch` to the one before", read_only=True)
    subscribers: int = setting(1, "Number of subscribers of the clouds to wait for", bounds=(0, 100))
    discovery_s: float = setting(
        3.5,
        "Time for which no publisher or subscriber must have come or gone before the first cloud, so that all know each other:"
        " other programs announce themselves every 3 s; 0 does not wait",
        bounds=(0.0, 60.0),
    )
    wait_for: tuple[str, ...] = setting(
        (), "Topics that must have a subscriber, besides the nodes of the graph, before the first cloud", read_only=True
    )
    wait_limit_s: float = setting(
        10.0, "Longest wait for `wait_for` and `discovery_s`; then it plays without them", bounds=(0.0, 3600.0)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.intrinsics) != 4:
            raise ConfigError(f"intrinsics: {list(self.intrinsics)} is not fx, fy, cx, cy")
        if len(self.table) != 4 or (any(self.table) and not any(self.table[:3])):
            raise ConfigError(f"table: {list(self.table)} is not a plane a, b, c, d")

    @property
    def camera(self) -> DepthCamera:
        """The camera of depth images, as far as it is stated; a `ConfigError` if it is stated twice."""
        return DepthCamera(
            intrinsics=self.intrinsics if any(self.intrinsics) else (),
            info=Path(self.camera_info) if self.camera_info else None,
            scale=self.depth_scale or None,
            rectified=self.rectified == "yes" if self.rectified else None,
            info_topic=self.info_topic,
            color=self.color,
        )


class ReplayNode(ThreadNode[ReplayConfig]):
    """The replay as a lifecycle node; activating it again plays from the beginning."""

    default_name, config_class = "replay", ReplayConfig
    exclusive_topics = ("points", "objects", GRASPS_TOPIC, "touch")

    def __init__(self, **options: Any) -> None:
        self._phase = "waiting"  # or `playing`, and at the end `finished` or `stopped`
        self.played: Counter[str] = Counter()  # published messages by topic, also of the clouds
        self.unanswered = 0  # in lockstep, clouds without an answer on `touch` in time
        self.first_refusal = ""  # of the entries that could not be read
        self.clouds_topic = ""  # full name of the topic of the clouds, once it is known
        self._source: Source | None = None
        self._topic_publishers: dict[str, Any] = {}
        self._left_out: dict[str, str] = {}
        self._table: Any = None
        self._answered = threading.Condition()
        self._last_answer_ns = -1
        self._restamped: dict[int, int] = {}  # new stamps of the latest depth images and colours, by their own [ns]
        super().__init__(**options)

    @property
    def outcome(self) -> str:
        """State of the replay: `waiting` or `playing`, and at the end `finished`, `stopped` or `failed`."""
        return "failed" if self.failure else self._phase

    @property
    def unreadable(self) -> int:
        """Entries of the source that could not be read and were not played; each is logged."""
        return self.statistics.summary().dropped.get("unreadable", 0)

    def _setup(self) -> None:
        config = self.config
        if not config.path:
            raise ConfigError("path: is empty; set it to a recording, a folder or a file")
        self._source = open_source(config.path, config.topic or None, frame_id=_FRAME, camera=config.camera)
        for note in self._source.notes:
            self.get_logger().warning(note)
        segmented = cloud_is_object(self._source)  # samples, and files whose clouds are not organised
        if self._source.info_topic:
            compressed = self._source.topic.endswith("/compressedDepth")
            clouds = self.advertise(CompressedImage if compressed else Image, self._source.topic, depth=_DEPTH)
        else:
            clouds = self.advertise(PointCloud2, CLOUD_TOPIC if segmented else "points", depth=_DEPTH)
        self._topic_publishers[CLOUDS], self.clouds_topic = clouds, str(clouds.topic_name)
        self._table = self.advertise(TablePlane, "table", depth=_DEPTH) if segmented else None
        self._advertise_others(self._source)
        if config.lockstep:
            answers = self.create_subscription(TouchPredictionArray, "touch", self._on_answer, _DEPTH)
            self.closing.callback(self.destroy_subscription, answers)
        try:
            self._wait_for = [self.resolve_topic_name(name) for name in config.wait_for]
        except ConfigError as err:
            raise ConfigError(f"wait_for: {err}") from err

    def _start(self) -> None:
        self.played.clear()
        self.unanswered = 0
        self._last_answer_ns = -1
        self.first_refusal = ""

    def _stop(self) -> None:
        self.stopping.set()
        with self._answered:
            self._answered.notify_all()
        super()._stop()

    def _teardown(self) -> None:
        self._topic_publishers.clear()
        self._source = None

    def has_ended(self) -> bool:
        """Return whether there is nothing more to play, or the source cannot be opened: its parameters are read-only."""
        cannot_start = self.config.autostart and self.state_name == "unconfigured" and bool(self.failure)
        return cannot_start or (self.ended.is_set() and self.outcome != "stopped")  # that may be activated again

    def diagnose(self, report: Report) -> None:
        """Report the state of the replay, and counts by topic."""
        clouds = len(self._source) if self._source is not None else 0
        report.values |= {"replay": self.outcome, "source": self.config.path, "clouds": str(clouds)}
        report.values["unanswered"] = str(self.unanswered)
        report.values |= {f"played.{topic}": str(count) for topic, count in self.played.items()}
        report.values |= {f"left_out.{topic}": reason for topic, reason in self._left_out.items()}

    # The thread.

    def _run(self) -> None:
        self._phase = "waiting"
        if self._wait_for_subscribers():
            self.look_for_second_graph()
            self._phase = "playing"
            self._play()
        self._phase = "stopped" if self.stopping.is_set() else "finished"

    def _wait_for_subscribers(self) -> bool:
        """Wait for subscribers of the clouds, and then, with a limit, until all nodes know each other; False if the replay must stop."""
        config = self.config
        if not self._wait(self._missing_ends, math.inf, 0.5):
            return False
        if not config.subscribers and not config.wait_for:
            return True
        seen, since_s = ends_of_topics(self), time.monotonic()

        def unsettled() -> list[str]:
            nonlocal seen, since_s
            if (now := ends_of_topics(self)) != seen:
                seen, since_s = now, time.monotonic()
            absent = [f"a subscriber of {topic}" for topic in self._wait_for if not is_heard_outside(self, topic)]
            if time.monotonic() - since_s < config.discovery_s:
                absent.append(f"{config.discovery_s:g} s in which no node comes or goes")
            return absent

        return self._wait(unsettled, config.wait_limit_s, 0.5 + config.discovery_s)

    def _wait(self, missing: Callable[[], list[str]], limit_s: float, say_s: float) -> bool:
        """Wait until nothing is missing, or for a limit, and say after some time what is; False if the replay must stop."""
        began, logged = time.monotonic(), False
        while texts := missing():
            waited_s, text = time.monotonic() - began, " and ".join(texts)
            if waited_s >= limit_s:
                self.get_logger().warning(f"plays after {limit_s:g} s, still without {text}")
                return True
            if waited_s >= say_s and not logged:
                logged = True
                self.get_logger().info(f"waits for {text}")
            if self.stopping.wait(_POLL_S):
                return False
        return True

    def _missing_ends(self) -> list[str]:
        """Name the subscribers and publishers that the first cloud waits for."""
        clouds, missing = self._topic_publishers[CLOUDS], []
        if (subscribers := clouds.get_subscription_count()) < self.config.subscribers:
            count = f"{subscribers} of {self.config.subscribers} (is the graph running? --no-wait waits for none)"
            missing.append(f"subscribers of {clouds.topic_name}, {count}")
        if self.config.lockstep and not self.count_publishers("touch"):
            missing.append("a publisher of touch")
        return missing

    def _play(self) -> None:
        assert self._source is not None  # noqa: S101  setup made it
        shift_ns, began = 0, time.monotonic()
        while True:
            pace, empty = Pace(self.config.rate_hz, self.config.longest_pause_s), True
            for entry in entries(self._source, self._topic_publishers.keys() - {CLOUDS}):
                if empty:  # opening the source takes longer than reading the next entry
                    began = max(began, time.monotonic())
                due, empty = began + pace.due_s(entry), False
                if pace.cut_s:
                    self.get_logger().warning(f"{entry.name}: {pace.cut_s:.0f} s of the pause before it are left out")
                if not self._play_entry(entry, due, shift_ns):
                    return
            if not self.config.loop or empty:
                break
            shift_ns += pace.length_ns
            began += pace.length_s
            if self.stopping.wait(max(began - time.monotonic(), 0.0)):
                return
        for remark in self._source.remarks:
            self.get_logger().warning(remark)
        for publisher in self._topic_publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=2.0))

    def _play_entry(self, entry: Entry, due: float, shift_ns: int) -> bool:
        """Publish one message when it is due; False if the replay must stop."""
        arrived = self.statistics.receive() if entry.topic == CLOUDS else 0.0
        if entry.refusal:
            self.first_refusal = self.first_refusal or entry.refusal
            self.statistics.drop("unreadable")
            self.get_logger().warning(entry.refusal)
            return not self.stopping.is_set()
        if self.stopping.wait(max(due - time.monotonic(), 0.0)):
            if entry.topic == CLOUDS:
                self.statistics.drop("stopped")
            return False
        data = entry.data
        if entry.stamped and self.config.restamp:
            data = with_stamp(data, self._new_stamp(entry))
        elif entry.stamped and shift_ns:
            data = with_stamp(data, read_header(data)[0] + shift_ns)
        if entry.topic == CLOUDS:
            self._publish_cloud(data)
            self.statistics.use(arrived, time.monotonic() - due)
        else:
            self._topic_publishers[entry.topic].publish(data)
            self.played[entry.topic] += 1
        return True

    def _new_stamp(self, entry: Entry) -> int:
        """Return the time of now [ns]; of a depth image and its colours, which keep one stamp, that of the first of them."""
        now_ns = self.get_clock().now().nanoseconds
        assert self._source is not None  # noqa: S101  setup made it
        if not self._source.color_topic or entry.topic not in (CLOUDS, self._source.color_topic):
            return now_ns
        stamp, _ = read_header(entry.data)
        if self._restamped.get(stamp, now_ns) < now_ns - _TOGETHER_NS:
            self._restamped.clear()  # of the round before
        while len(self._restamped) > _DEPTH:
            del self._restamped[next(iter(self._restamped))]
        return self._restamped.setdefault(stamp, now_ns)

    def _publish_cloud(self, data: bytes) -> None:
        stamp_ns, frame_id = read_header(data)
        if self._table is not None:
            if any(self.config.table):
                plane = Plane.from_coefficients(self.config.table)
            else:
                plane = assumed_table(decode_cloud(read_serialized(data, PointCloud2)))
            header = header_to_msg(frame_id, stamp_ns)
            self._table.publish(TablePlane(header=header, plane=plane_to_msg(plane), status=Status.OK))
        self._topic_publishers[CLOUDS].publish(data)
        self.played[self.clouds_topic] += 1
        if self.config.lockstep:
            with self._answered:
                self.unanswered += not self._answered.wait_for(
                    lambda: self._last_answer_ns == stamp_ns or self.stopping.is_set(), _ANSWER_S
                )

    def _on_answer(self, message: TouchPredictionArray) -> None:
        with self._answered:
            self._last_answer_ns = stamp_ns(message.header.stamp)
            self._answered.notify_all()

    def _advertise_others(self, source: Source) -> None:
        classes, self._left_out = playable(source.others, self.get_namespace())
        infos = [other for other in source.others if other.name == source.info_topic]
        classes |= dict.fromkeys(infos, CameraInfo)  # also where this package's camera node was recorded
        colours = [other for other in source.others if other.name == source.color_topic]
        for topic in colours:
            classes[topic] = CompressedImage if topic.type.endswith("CompressedImage") else Image
            self._left_out.pop(topic.name, None)
            if source.converted:
                del classes[topic]
                self._left_out[topic.name] = "the clouds have its colours"
        for topic, message in classes.items():
            durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
            profile = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
            publisher = self._topic_publishers[topic.name] = self.create_publisher(message, topic.name, profile)
            self.closing.callback(self.destroy_publisher, publisher)
        self._left_out = {name: why for name, why in self._left_out.items() if name != source.info_topic}
        for topic_name, reason in self._left_out.items():
            self.get_logger().info(f"{topic_name}: not played: {reason}")
