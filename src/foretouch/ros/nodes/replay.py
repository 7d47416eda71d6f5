# SPDX-License-Identifier: Apache-2.0
"""Which topics of a recording can go along with its clouds, and why the others cannot.

Plays a recording, a folder or a file into the graph as if a camera did.

Threads: one thread reads ahead by one message, waits until it is due and publishes it; the executor's
callbacks only take note of answers. Messages of a recording go out byte for byte as they were recorded,
unless `restamp` is set.

`replay_status` (`diagnostic_msgs/DiagnosticStatus`, latched) tells where the replay stands: `waiting`,
`playing`, then `finished`, `stopped` or `failed`, with the counts. In the same process, `ReplayNode.ended`
is set at the end.
"""

from __future__ import annotations

import importlib
import re
import threading
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ament_index_python import has_resource
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from foretouch.config import setting
from foretouch.dataset.bag import Topic
from foretouch.dataset.cdr import read_header, with_stamp
from foretouch.dataset.playlist import CLOUDS, Pace, Step, cloud_is_object, other_topics, steps
from foretouch.dataset.source import Source, open_source
from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.messages.conversions import header_to_msg, plane_to_msg, stamp_ns
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.types import Plane
from foretouch_msgs.msg import Status, TablePlane, TouchPredictionArray

__all__ = ["ReplayConfig", "ReplayNode", "message_class", "playable"]


_TYPE = re.compile(r"([a-z]\w*)/msg/([A-Z]\w*)")
_LIVE_ONLY = frozenset({"/diagnostics", "/parameter_events", "/rosout"})
_INPUTS = frozenset({"executed_grasp"})  # of the graph's own namespace, sent by the robot


def playable(topics: Iterable[Topic], namespace: str) -> tuple[dict[Topic, type], dict[str, str]]:
    """Sort the topics of a recording.

    Args:
        topics: Without that of the clouds.
        namespace: Of the graph: what its nodes publish now must not be mixed with what they published then.

    Returns:
        The message class of each topic that can be played, and for each other topic with messages the reason.
    """
    classes: dict[Topic, type] = {}
    reasons: dict[str, str] = {}
    for topic in topics:
        if not topic.count:
            continue
        reason = _kept_back(topic.name, namespace)
        if not reason:
            found, reason = message_class(topic)
            if found is not None:
                classes[topic] = found
                continue
        reasons[topic.name] = f"{reason} ({topic.count} messages)"
    return classes, reasons


def message_class(topic: Topic) -> tuple[type | None, str]:
    """The class of a topic's messages where this machine has it with the same fields; else None and the reason."""
    match = _TYPE.fullmatch(topic.type)
    if match is None:
        return None, f"type {topic.type or 'mixed'} is no message type"
    package, name = match.groups()
    # A recording may name any module: only what is installed as ROS interfaces is imported.
    if not has_resource("rosidl_interfaces", package):
        return None, f"type {topic.type} is not installed"
    try:
        found: Any = getattr(importlib.import_module(f"{package}.msg"), name)
        fields = tuple(found.get_fields_and_field_types())
    except (ImportError, AttributeError):
        return None, f"type {topic.type} is not installed"
    recorded = tuple(field.lower() for field in topic.fields)  # some names of ROS 1 had capitals
    if recorded != fields:
        return None, f"type {topic.type} had other fields when it was recorded"
    return found, ""


def _kept_back(name: str, namespace: str) -> str:
    if name in _LIVE_ONLY:
        return "tells of nodes that run"
    prefix = namespace.rstrip("/") + "/"
    if name.startswith(prefix) and name.removeprefix(prefix) not in _INPUTS:
        return f"under {namespace} this graph publishes itself"
    return ""


_DEPTH = 100  # messages that a slow reliable subscriber may lag behind
_ACKNOWLEDGED_S = 2.0
_POLL_S = 0.02


@dataclass(frozen=True, kw_only=True)
class ReplayConfig(NodeConfig):
    """Settings of the replay."""

    path: str = setting("", "Recording, folder of clouds or samples, or file", read_only=True)
    topic: str = setting("", "Topic of the clouds, for a recording that holds several", read_only=True)
    publish: str = setting(
        "auto",
        "Where the clouds go: `points`, to be segmented, or `object_cloud`, beside `table`; `auto` takes the"
        " second for samples and for files whose clouds are not organised",
        choices=["auto", "points", "object_cloud"],
        read_only=True,
    )
    table: tuple[float, ...] = setting(
        (0.0, 0.0, 1.0, -1.27), "a, b, c, d of the plane published beside `object_cloud`", read_only=True
    )
    rate_hz: float = setting(
        0.0,
        "Clouds a second; 0 keeps the recorded times, 10 a second for files",
        unit="Hz",
        minimum=0.0,
        maximum=1000.0,
    )
    loop: bool = setting(False, "Begin anew at the end, with stamps that go on")
    restamp: bool = setting(False, "Give every message the time of its publication as stamp")
    lockstep: bool = setting(False, "Publish a cloud when `touch` has answered the one before", read_only=True)
    answer_timeout_s: float = setting(5.0, "Longest wait in lockstep", unit="s", minimum=0.01, maximum=3600.0)
    subscribers: int = setting(1, "Subscribers of the clouds to wait for; 0 does not wait", minimum=0, maximum=100)
    settle_s: float = setting(
        0.3, "Pause after they were found, for them to find us", unit="s", minimum=0.0, maximum=60.0
    )
    frame_id: str = setting("camera_depth_optical_frame", "Frame of clouds from files, which name none", read_only=True)
    other_topics: bool = setting(True, "Play the other topics of a recording too", read_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.table) != 4 or not any(self.table[:3]):
            raise ConfigError(f"ReplayConfig.table: {list(self.table)} is not a plane a, b, c, d")


class ReplayNode(ForetouchNode[ReplayConfig]):
    """The replay as a lifecycle node; activating it again plays from the beginning.

    Attributes:
        ended: Set when there is nothing more to play, for whatever reason; then `outcome` tells which.
        outcome: `waiting`, `playing`, `finished`, `stopped` or `failed`.
        reason: Why it failed, or "".
        played: Messages published by topic, the clouds under the name they were published by.
        unanswered: Clouds that `touch` did not answer in time, in lockstep.
    """

    def __init__(self, name: str = "replay", **options: Any) -> None:
        self.ended = threading.Event()
        self.outcome = "waiting"
        self.played: Counter[str] = Counter()
        self.unanswered = 0
        self.reason = ""
        self._source: Source | None = None
        self._senders: dict[str, Any] = {}
        self._left_out: dict[str, str] = {}
        self._table: Any = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._answered = threading.Condition()
        self._last_answer_ns = -1
        super().__init__(name, ReplayConfig, **options)
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        self._status = self.create_publisher(DiagnosticStatus, "replay_status", latched)

    @property
    def clouds_topic(self) -> str:
        """Full name of the topic that the clouds go to; "" before it is known."""
        return str(self._senders[CLOUDS].topic_name) if CLOUDS in self._senders else ""

    @property
    def unreadable(self) -> int:
        """Entries of the source that could not be read, and so were not played; the log names each."""
        return self.statistics.snapshot().dropped.get("unreadable", 0)

    # Hooks of the base.

    def setup(self) -> None:
        """Open the source and advertise what it holds."""
        if not self.config.path:
            raise ConfigError("path: is empty; name a recording, a folder or a file")
        self._source = open_source(self.config.path, self.config.topic or None, frame_id=self.config.frame_id)
        behind = self.config.publish == "object_cloud"
        if self.config.publish == "auto":
            behind = cloud_is_object(self._source)
        self._senders[CLOUDS] = self.advertise(PointCloud2, "object_cloud" if behind else "points", depth=_DEPTH)
        self._table = self.advertise(TablePlane, "table", depth=_DEPTH) if behind else None
        self._advertise_others(self._source)
        if self.config.lockstep:
            self._inputs.append(self.create_subscription(TouchPredictionArray, "touch", self._take_answer, _DEPTH))

    def start(self) -> None:
        """Play from the beginning."""
        self._stopping.clear()
        self.ended.clear()
        self.played.clear()
        self.unanswered = 0
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Break off, after the message at hand."""
        self._stopping.set()
        with self._answered:
            self._answered.notify_all()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def teardown(self) -> None:
        """Forget the source."""
        for topic, publisher in self._senders.items():
            if topic != CLOUDS:
                self.destroy_publisher(publisher)
        self._senders.clear()
        self._source = None

    def has_ended(self) -> bool:
        """Whether there is nothing more to play."""
        return self.ended.is_set() and self.outcome != "stopped"  # a stopped one may be activated again

    def errors(self) -> tuple[str, ...]:
        """Why the replay broke off."""
        return (self.reason,) if self.outcome == "failed" else ()

    def notes(self) -> dict[str, str]:
        """Where the replay stands."""
        return {
            "replay": self.outcome,
            "source": self.config.path,
            "clouds": str(len(self._source) if self._source is not None else 0),
            "unanswered": str(self.unanswered),
            **{f"played.{topic}": str(count) for topic, count in self.played.items()},
            **{f"left_out.{topic}": reason for topic, reason in self._left_out.items()},
        }

    # The thread.

    def _run(self) -> None:
        self._tell("waiting")
        try:
            if self._wait_for_subscribers():
                self._tell("playing")
                self._play()
            self._tell("stopped" if self._stopping.is_set() else "finished")
        except ForetouchError as err:
            self._tell("failed", str(err))
        except Exception as err:  # noqa: BLE001  a thread that ends silently would leave everybody waiting
            if self.context.ok():
                self._tell("failed", f"{type(err).__name__}: {err}")
        finally:
            self.ended.set()

    def _wait_for_subscribers(self) -> bool:
        def ready() -> bool:
            matched = int(self._senders[CLOUDS].get_subscription_count())
            answerable = not self.config.lockstep or self.count_publishers("touch") > 0
            return self.state_name == "active" and matched >= self.config.subscribers and answerable

        while not ready():
            if self._stopping.wait(_POLL_S):
                return False
        return not self._stopping.wait(self.config.settle_s if self.config.subscribers else 0.0)

    def _play(self) -> None:
        assert self._source is not None  # noqa: S101  setup made it
        shift_ns, began = 0, time.monotonic()
        while True:
            pace = Pace(self.config.rate_hz)
            for step in steps(self._source, self._senders.keys() - {CLOUDS}):
                if not self._play_step(step, began + pace.due_s(step), shift_ns):
                    return
            if not self.config.loop:
                break
            shift_ns += pace.length_ns
            began += pace.length_s
        for publisher in self._senders.values():
            publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED_S))

    def _play_step(self, step: Step, due: float, shift_ns: int) -> bool:
        """Publish one message when it is due; False if the replay is to stop."""
        arrived = self.statistics.arrive() if step.topic == CLOUDS else 0.0
        if step.refusal:
            self.statistics.drop("unreadable")
            self.get_logger().warning(step.refusal)
            return not self._stopping.is_set()
        if self._stopping.wait(max(due - time.monotonic(), 0.0)):
            if step.topic == CLOUDS:
                self.statistics.drop("stopped")
            return False
        data = self._stamp(step, shift_ns)
        if step.topic == CLOUDS:
            self._publish_cloud(data)
            self.statistics.use(arrived, time.monotonic() - due)
        else:
            self._senders[step.topic].publish(data)
            self.played[step.topic] += 1
        return True

    def _stamp(self, step: Step, shift_ns: int) -> bytes:
        if not step.stamped or not (self.config.restamp or shift_ns):
            return step.data
        if self.config.restamp:
            return with_stamp(step.data, self.get_clock().now().nanoseconds)
        return with_stamp(step.data, read_header(step.data).stamp_ns + shift_ns)

    def _publish_cloud(self, data: bytes) -> None:
        header = read_header(data)
        if self._table is not None:
            plane = plane_to_msg(Plane.from_coefficients(self.config.table))
            stamped = header_to_msg(header.frame_id, header.stamp_ns)
            self._table.publish(TablePlane(header=stamped, plane=plane, status=Status.OK))
        self._senders[CLOUDS].publish(data)
        self.played[self.clouds_topic] += 1
        if self.config.lockstep and not self._wait_for_answer(header.stamp_ns):
            self.unanswered += 1

    # Answers.

    def _take_answer(self, message: TouchPredictionArray) -> None:
        with self._answered:
            self._last_answer_ns = stamp_ns(message.header.stamp)
            self._answered.notify_all()

    def _wait_for_answer(self, stamp: int) -> bool:
        with self._answered:
            return self._answered.wait_for(
                lambda: self._last_answer_ns == stamp or self._stopping.is_set(), self.config.answer_timeout_s
            )

    # Telling.

    def _advertise_others(self, source: Source) -> None:
        if not self.config.other_topics:
            return
        classes, self._left_out = playable(other_topics(source), self.get_namespace())
        for topic, message in classes.items():
            durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
            profile = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
            self._senders[topic.name] = self.create_publisher(message, topic.name, profile)
        for topic_name, reason in self._left_out.items():
            self.get_logger().info(f"{topic_name}: not played: {reason}")

    def _tell(self, outcome: str, reason: str = "") -> None:
        self.outcome, self.reason = outcome, reason
        level = DiagnosticStatus.ERROR if outcome == "failed" else DiagnosticStatus.OK
        values = {**self.notes(), "unreadable": str(self.unreadable)}
        self._status.publish(
            DiagnosticStatus(
                level=level,
                name=self.get_fully_qualified_name(),
                message=f"{outcome}: {reason}" if reason else outcome,
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
        )
        if reason:
            self.get_logger().error(reason)
