# SPDX-License-Identifier: Apache-2.0
"""What the recorder receives: serialised messages of its topics, their queue and their counts."""

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.base.bounded_queue import BoundedQueue
from foretouch.cloud.io.depth_messages import info_topic
from foretouch.dataset.labelling.assembler import Role
from foretouch.dataset.recordings.records import TopicCounts
from foretouch.errors import MissingDependencyError
from foretouch.ros.messages.tactile import TactileInput, message_class
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.subscription import InputTopic, SerializedMessage
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC, TABLE_TOPIC
from foretouch_msgs.msg import ExecutedGrasp, GraspArray, TablePlane, TopicAccount, TouchPredictionArray

_IMAGES_KEPT: Final = 100  # depth images, or clouds of objects, that may wait in the middleware
_CLOUDS_KEPT: Final = 20  # clouds of the camera that may wait there
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
class RecordedTopic(InputTopic):
    """A topic whose messages are received serialised; `depth` of them wait while this process does not get to run."""

    depth: int = 1000
    raw: bool = True
    role: Role | Literal["touch", "scene", "info", ""] = ""  # of its messages in samples or checks
    optional: bool = False  # whether nothing is reported of it until a message arrives


def sample_topics(config: TactileInput, *, points: bool) -> list[RecordedTopic]:
    """List the topics of samples, the hand's first.

    Args:
        config: Topic and type of the hand's messages.
        points: Whether the camera's clouds are among them.
    """
    topics = [
        RecordedTopic(config.tactile_topic, message_class(config.tactile.message_type), role="tactile"),
        RecordedTopic(CLOUD_TOPIC, PointCloud2, _IMAGES_KEPT, role="cloud"),
        RecordedTopic(TABLE_TOPIC, TablePlane, role="table"),
        RecordedTopic(GRASPS_TOPIC, GraspArray, role="grasps"),
        RecordedTopic("touch", TouchPredictionArray, role="touch"),
        RecordedTopic(EXECUTED_TOPIC, ExecutedGrasp, role="executed"),
    ]
    if points:
        topics.append(RecordedTopic("points", PointCloud2, _CLOUDS_KEPT, role="scene"))
    return topics


def depth_topics(images: str) -> list[RecordedTopic]:
    """List a topic of depth images, raw or `compressedDepth`, and the topic of the camera infos beside it."""
    kind = CompressedImage if images.endswith("/compressedDepth") else Image
    infos = RecordedTopic(info_topic(images), CameraInfo, role="info")
    return [RecordedTopic(images, kind, _IMAGES_KEPT, role="scene"), infos]


def colour_topic(images: str) -> RecordedTopic:
    """Return a topic of the colours of depth images, raw or `compressed`."""
    return RecordedTopic(images, CompressedImage if images.endswith("/compressed") else Image, _IMAGES_KEPT)


def robot_topics() -> tuple[list[RecordedTopic], list[str]]:
    """List the topics of the robot, which are recorded as far as they are published, and the packages that are missing for some."""
    topics, missing = [], set()
    for name, type_name in _ROBOT_TOPICS.items():
        try:
            message = message_class(type_name)
        except MissingDependencyError:
            missing.add(type_name.partition("/")[0])
        else:
            topics.append(RecordedTopic(name, message, optional=True, latched=name in _LATCHED))
    return topics, sorted(missing)


class MessageQueue(BoundedQueue[SerializedMessage]):
    """Serialised messages between the executor's callbacks and the thread that writes them, with counts by topic.

    It never blocks a callback. The oldest messages are kept, so that the file has one gap only.

    Args:
        most_bytes: Limit of the messages that wait.
    """

    def __init__(self, most_bytes: int) -> None:
        super().__init__(most_bytes, when_full="reject", size_of=lambda stream: len(stream.data), on_drop=self._count)
        self._refused: Counter[str] = Counter()

    def take(self, timeout_s: float) -> tuple[list[SerializedMessage], Counter[str]]:
        """Take all messages, after waiting for the first, and how many were rejected since the last call, by topic."""
        with self._changed:
            messages, refused = self.get_all(timeout_s), self._refused
            self._refused = Counter()
            return messages, refused

    def waiting(self) -> Counter[str]:
        """Count the messages that wait, and those rejected since the last `take`, by topic."""
        with self._changed:
            return Counter(item.topic for item in self._items) + self._refused

    def _count(self, message: SerializedMessage, _reason: str) -> None:
        if not self.closed:  # else it came after the end of the session
            self._refused[message.topic] += 1


class RecorderInputs:
    """The subscriptions of the recorder; without a session, messages are only counted.

    Args:
        node: Subscribes; it must be configuring.
        topics: What to subscribe to.

    Attributes:
        topics: The topics by full name.
        streams: The subscriptions to them.
    """

    def __init__(self, node: ForetouchNode[Any], topics: Sequence[RecordedTopic]) -> None:
        self._queue: MessageQueue | None = None
        self._latched: deque[SerializedMessage] = deque(maxlen=_LATCHED_KEPT)
        self._lock = threading.Lock()  # a latched message is written once in a session
        self._arrived: Counter[str] = Counter()
        self._ticks = deque([(time.monotonic(), Counter[str]())], maxlen=11)
        self.topics = {node.resolve_topic_name(topic.name): topic for topic in topics}
        self.streams = {
            name: node.subscribe(topic, partial(self._receive, latched=bool(topic.latched)))
            for name, topic in self.topics.items()
        }

    def open(self, queue: MessageQueue) -> None:
        """Begin a session: restart the counts, and put messages into its queue, first the latched ones of before."""
        for stream in self.streams.values():
            stream.losses.count = 0
        with self._lock:
            for message in self._latched:
                queue.put(replace(message, received_ns=time.time_ns()))
            self._queue = queue

    def close(self) -> None:
        """End the session."""
        self._queue = None

    def tick(self) -> None:
        """Update the rates."""
        self._ticks.append((time.monotonic(), Counter(self._arrived)))

    def accounts(self, counts: Mapping[str, TopicCounts]) -> list[TopicAccount]:
        """Make the accounts of the topics, from what a session has counted, and what waits for it."""
        queue = self._queue
        waiting: Counter[str] = Counter() if queue is None else queue.waiting()
        (first_s, first), (last_s, last) = self._ticks[0], self._ticks[-1]
        made = []
        for name, stream in self.streams.items():
            if self.topics[name].optional and not (name in counts or self._arrived[name]):
                continue
            count = counts.get(name, TopicCounts())
            account = TopicAccount(topic=name, written=count.written, lost=count.lost, reliable=stream.reliable)
            account.received, account.waiting = count.received + waiting[name], count.pending + waiting[name]
            account.drop_reasons, account.drop_counts = names_and_counts(count.dropped)
            account.rate = (last[name] - first[name]) / (last_s - first_s) if last_s > first_s else 0.0
            made.append(account)
        return made

    def _receive(self, message: SerializedMessage, *, latched: bool) -> None:
        self._arrived[message.topic] += 1
        with self._lock:
            if latched and all(message.data != kept.data for kept in self._latched):
                self._latched.append(message)
            if (queue := self._queue) is not None:
                queue.put(message)


def names_and_counts(counted: Mapping[str, int]) -> tuple[list[str], list[int]]:
    """List what was counted at least once, in order of the names, as messages hold it."""
    present = {name: count for name, count in sorted(counted.items()) if count > 0}
    return list(present), list(present.values())
