# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that receive serialised messages: those of the recorder, with their queue and statistics, and of the bridge."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import Any, Final

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.bounded_queue import BoundedQueue
from foretouch.cloud.io.depth_messages import info_topic
from foretouch.ros.messages.tactile import TactileInput, tactile_class
from foretouch.ros.runtime.subscription import FollowingSubscription
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC
from foretouch_msgs.msg import ExecutedGrasp, GraspArray, TablePlane, TouchPredictionArray

_LATCHED_KEPT: Final = 50  # messages of latched topics that are kept for the sessions to come

#: Topics of the robot, for viewers: no sample is made of them. With the types of their messages.
_ROBOT_TOPICS: Final = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/robot_description": "std_msgs/msg/String",
}
_LATCHED: Final = ("/tf_static", "/robot_description")


@dataclass(frozen=True)
class InputTopic:
    """A topic whose serialised messages are received."""

    name: str  # before remapping, which may be relative to the namespace
    message: type  # class of its messages
    depth: int  # queue size of the middleware
    optional: bool = False  # whether nothing is reported of it until a message arrives
    latched: bool = False  # whether its publishers send their last messages to late subscribers (transient local)


@dataclass(frozen=True, slots=True)
class SerializedMessage:
    """A message as it was received."""

    topic: str  # full name
    data: bytes  # CDR
    received_ns: int  # when the middleware received it [ns]
    sent_ns: int  # when it was published [ns]
    sequence: int | None  # sequence number of its publisher; None where the middleware has none


class SerializedInput(FollowingSubscription):
    """The subscription of a node to one topic, whose messages are passed on as bytes.

    Args:
        node: The node.
        topic: The topic.
        receive: Called with every message, in the thread of the executor; must return at once.
    """

    def __init__(self, node: Node, topic: InputTopic, receive: Callable[[SerializedMessage], None]) -> None:
        self.topic = topic
        self._forward = receive
        super().__init__(
            node,
            topic.message,
            topic.name,
            self._pass_on,
            depth=topic.depth,
            group=MutuallyExclusiveCallbackGroup(),
            latched=topic.latched,
            raw=True,
        )

    def _pass_on(self, data: bytes, info: Any) -> None:
        times = info["received_timestamp"], info["source_timestamp"]
        self._forward(SerializedMessage(self.name, data, *times, info.get("publication_sequence_number")))


def sample_topics(config: TactileInput, *, depth: int, cloud_depth: int, points_depth: int) -> list[InputTopic]:
    """The topics of samples, the hand's first, with the clouds of the camera if their depth is not 0."""
    topics = [
        InputTopic(config.tactile_topic, tactile_class(config.tactile.message_type), depth),
        InputTopic(CLOUD_TOPIC, PointCloud2, cloud_depth),
        InputTopic("table", TablePlane, depth),
        InputTopic(GRASPS_TOPIC, GraspArray, depth),
        InputTopic("touch", TouchPredictionArray, depth),
        InputTopic(EXECUTED_TOPIC, ExecutedGrasp, depth),
    ]
    if points_depth:
        topics.append(InputTopic("points", PointCloud2, points_depth))
    return topics


def depth_topics(images: str, depth: int) -> list[InputTopic]:
    """The topic of depth images, raw or `compressedDepth`, and of the camera infos beside it."""
    kind = CompressedImage if images.endswith("/compressedDepth") else Image
    return [InputTopic(images, kind, depth), InputTopic(info_topic(images), CameraInfo, 10 * depth)]


def robot_topics(depth: int) -> tuple[list[InputTopic], list[str]]:
    """The topics of the robot, which are recorded as far as they are published, and the packages that are missing for some."""
    topics, missing = [], set()
    for name, type_name in _ROBOT_TOPICS.items():
        package, _, kind = type_name.split("/")
        try:
            message = getattr(import_module(f"{package}.msg"), kind)
        except ImportError:
            missing.add(package)
            continue
        topics.append(InputTopic(name, message, depth, optional=True, latched=name in _LATCHED))
    return topics, sorted(missing)


class MessageQueue(BoundedQueue[SerializedMessage]):
    """Serialised messages between the executor's callbacks and the thread that writes them, with counts by topic.

    It never blocks a callback. Its memory is bounded, to so many bytes: the oldest messages are kept, so that the file has
    one gap only.
    """

    def __init__(self, most_bytes: int) -> None:
        super().__init__(most_bytes, when_full="reject", size_of=lambda stream: len(stream.data), on_drop=self._count)
        self._refused: Counter[str] = Counter()

    def take(self, timeout_s: float) -> tuple[list[SerializedMessage], Counter[str]]:
        """All messages that wait (see `get_all`), and how many were rejected since the last call, by topic."""
        with self._changed:
            messages, refused = self.get_all(timeout_s), self._refused
            self._refused = Counter()
            return messages, refused

    def waiting(self) -> Counter[str]:
        """Messages that wait, and those rejected since the last `take`, by topic."""
        with self._changed:
            return Counter(item.topic for item in self._items) + self._refused

    def _count(self, message: SerializedMessage, _reason: str) -> None:
        if not self.closed:  # else it came after the end of the session
            self._refused[message.topic] += 1


@dataclass(frozen=True, kw_only=True)
class TopicStatistics:
    """Statistics of a topic beside the session's message counts."""

    waiting: int = 0  # messages in the queue
    reliable: bool = True  # whether lost messages are sent again
    rate_hz: float = 0.0  # rate of arrival [Hz]


class RecorderSubscriptions:
    """All subscriptions of the recorder; without a session, messages are only counted.

    `inputs` are the subscriptions by full name of the topic. `excluded` has a line for each type of publishers, as of the last
    `tick`, that no message is received from.
    """

    def __init__(self, node: Node, topics: Sequence[InputTopic]) -> None:
        self.inputs: dict[str, SerializedInput] = {}
        self.excluded: tuple[str, ...] = ()
        self._queue: MessageQueue | None = None
        self._latched: deque[SerializedMessage] = deque(maxlen=_LATCHED_KEPT)
        self._lock = threading.Lock()  # a latched message is written once in a session
        self._arrived: Counter[str] = Counter()
        self._ticks = deque([(time.monotonic(), Counter[str]())], maxlen=11)
        try:
            for topic in topics:
                stream = SerializedInput(node, topic, partial(self._receive, latched=topic.latched))
                self.inputs[stream.name] = stream
        except BaseException:  # such as an override that names no policy
            self.destroy()
            raise

    def open(self, queue: MessageQueue) -> None:
        """Begin a session: restart the counts, and put messages into its queue, first the latched ones of before."""
        for stream in self.inputs.values():
            stream.losses.count = 0
        with self._lock:
            for message in self._latched:
                queue.put(replace(message, received_ns=time.time_ns()))
            self._queue = queue

    def close(self) -> None:
        """End the session."""
        self._queue = None

    def lost(self) -> dict[str, int]:
        """Messages that the middleware has lost since `open`, by topic."""
        return {name: stream.losses.count for name, stream in self.inputs.items()}

    def tick(self) -> list[str]:
        """Update the rates and adapt to the publishers; gives a line for each replaced subscription and new `excluded` type."""
        self._ticks.append((time.monotonic(), Counter(self._arrived)))
        before = self.excluded
        self.excluded = tuple(text for stream in self.inputs.values() for text in stream.excluded())
        return [text for text in self.excluded if text not in before] + [
            f"{stream.name}: subscribed with {'reliable' if stream.reliable else 'best effort'} QoS, as its publishers offer"
            for stream in self.inputs.values()
            if stream.follow()
        ]

    def statistics(self) -> dict[str, TopicStatistics]:
        """Current statistics of each topic."""
        queue = self._queue
        waiting: Counter[str] = Counter() if queue is None else queue.waiting()
        (first_s, first), (last_s, last) = self._ticks[0], self._ticks[-1]
        return {
            name: TopicStatistics(
                waiting=waiting[name],
                reliable=stream.reliable,
                rate_hz=(last[name] - first[name]) / (last_s - first_s) if last_s > first_s else 0.0,
            )
            for name, stream in self.inputs.items()
            if self._arrived[name] or not stream.topic.optional
        }

    def destroy(self) -> None:
        """End all subscriptions."""
        for stream in self.inputs.values():
            stream.destroy()

    def _receive(self, message: SerializedMessage, *, latched: bool) -> None:
        self._arrived[message.topic] += 1
        with self._lock:
            if latched and all(message.data != kept.data for kept in self._latched):
                self._latched.append(message)
            if (queue := self._queue) is not None:
                queue.put(message)
