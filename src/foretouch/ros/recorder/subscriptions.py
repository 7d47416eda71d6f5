# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of the recorder: serialised messages into the queue of the session, and statistics of each topic.

A reliable subscriber receives nothing from a best-effort publisher. Therefore every subscription starts reliable, is
replaced by one with best effort as soon as a publisher on its topic offers no more, and by a reliable one when all
publishers are reliable again. A parameter `qos_overrides.<topic>.subscription.reliability` overrides that: the
subscription is then as the parameter demands, and a publisher that offers less is reported.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from foretouch.ros.recorder.message_queue import Arrival, MessageQueue
from foretouch.ros.recorder.status import TopicStatistics
from foretouch.ros.runtime.losses import SequenceNumbers

_ADAPTED = QoSPolicyKind.RELIABILITY
_OVERRIDDEN = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)


@dataclass(frozen=True)
class InputTopic:
    """A topic to record."""

    name: str  # name before remapping, which may be relative to the namespace
    message: type  # class of its messages
    depth: int  # queue size of the middleware

    @property
    def type_name(self) -> str:
        """Name of the type, such as `sensor_msgs/msg/PointCloud2`."""
        module = self.message.__module__.split(".")
        return f"{module[0]}/{module[1]}/{self.message.__name__}"


class RecorderInput:
    """The subscription to one topic.

    Args:
        node: The recorder.
        topic: The topic.
        receive: Called with every message, in a thread of the executor; must return at once.
        mismatch: Called with topic, `publisher` and event where a publisher offers less than a parameter demands.
        reliable: What it begins with, before it has adapted.

    Attributes:
        name: Full name of the topic.
        reliable: Whether lost messages are sent again.
    """

    def __init__(
        self,
        node: Node,
        topic: InputTopic,
        receive: Callable[[Arrival], None],
        mismatch: Callable[[str, str, Any], None],
        *,
        reliable: bool = True,
    ) -> None:
        self.topic = topic
        self.name: str = node.resolve_topic_name(topic.name)
        self.reliable = reliable
        self._node = node
        self._forward = receive
        self._mismatch = mismatch
        override = f"qos_overrides.{self.name}.subscription.{_ADAPTED.name.lower()}"
        self._overridden = override in getattr(node, "_parameter_overrides", {})
        self._lock = threading.Lock()
        self._numbers = SequenceNumbers()
        self._gaps = 0
        self._events = 0
        self._group = MutuallyExclusiveCallbackGroup()
        self._subscription = self._subscribe()

    @property
    def lost(self) -> int:
        """Messages that the middleware has lost since `reset`, by gaps in sequence numbers or by its own events."""
        with self._lock:
            return max(self._gaps, self._events)

    def reset(self) -> None:
        """Restart the count of lost messages."""
        with self._lock:
            self._gaps = self._events = 0

    def adapt(self) -> bool:
        """Adapt to what the publishers offer; whether the subscription was replaced."""
        if self._overridden:
            return False
        offered = {info.qos_profile.reliability for info in self._node.get_publishers_info_by_topic(self.name)}
        reliable = ReliabilityPolicy.BEST_EFFORT not in offered
        if not offered or reliable == self.reliable:
            return False
        old, self.reliable = self._subscription, reliable
        self._subscription = self._subscribe()
        self._node.destroy_subscription(old)
        return True

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self) -> Any:
        reliability = ReliabilityPolicy.RELIABLE if self.reliable else ReliabilityPolicy.BEST_EFFORT
        profile = QoSProfile(depth=self.topic.depth, reliability=reliability)
        subscription = self._node.create_subscription(
            self.topic.message,
            self.topic.name,
            self._receive,
            profile,
            callback_group=self._group,
            qos_overriding_options=QoSOverridingOptions((*_OVERRIDDEN, *[_ADAPTED] * self._overridden)),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=self._report_mismatch, message_lost=self._count_lost, use_default_callbacks=False
            ),
            raw=True,
        )
        self.reliable = profile.reliability == ReliabilityPolicy.RELIABLE  # overrides were written into it
        return subscription

    def _report_mismatch(self, event: Any) -> None:
        if self._overridden:  # otherwise `adapt` handles it
            self._mismatch(self.topic.name, "publisher", event)

    def _receive(self, data: bytes, info: Any) -> None:
        with self._lock:
            missing = self._numbers.missing(info)
            self._gaps += missing or 0
        if missing is None:  # it was received before the subscription was replaced
            return
        sequence = info.get("publication_sequence_number")
        self._forward(Arrival(self.name, data, info["received_timestamp"], info["source_timestamp"], sequence))

    def _count_lost(self, event: Any) -> None:
        with self._lock:
            self._events += event.total_count_change


_RATE_TICKS = 11


class RecorderSubscriptions:
    """All subscriptions of the recorder; without a session, messages are only counted.

    Args:
        node: The recorder.
        topics: The topics.
        mismatch: See `RecorderInput`.

    Attributes:
        inputs: Subscriptions by full name of the topic.
    """

    def __init__(self, node: Node, topics: Sequence[InputTopic], mismatch: Callable[[str, str, Any], None]) -> None:
        self.inputs: dict[str, RecorderInput] = {}
        self._queue: MessageQueue | None = None
        self._late: Counter[str] = Counter()
        self._arrived: Counter[str] = Counter()
        self._ticks: deque[tuple[float, Counter[str]]] = deque(maxlen=_RATE_TICKS)
        try:
            for topic in topics:
                one = RecorderInput(node, topic, self._receive, mismatch)
                self.inputs[one.name] = one
        except BaseException:  # such as an override that names no policy
            self.destroy()
            raise

    def open(self, queue: MessageQueue) -> None:
        """Begin a session: restart the counts, and put messages into its queue."""
        for one in self.inputs.values():
            one.reset()
        self._late.clear()
        self._queue = queue

    def close(self) -> None:
        """End the session."""
        queue, self._queue = self._queue, None
        if queue is not None:
            self._late = queue.late()

    def lost(self) -> dict[str, int]:
        """Messages that the middleware has lost since `open`, by topic."""
        return {name: one.lost for name, one in self.inputs.items()}

    def tick(self) -> list[str]:
        """Update the rates and adapt to the publishers; gives a line for each subscription that was replaced."""
        self._ticks.append((time.monotonic(), Counter(self._arrived)))
        return [
            f"{one.name}: subscribed with {'reliable' if one.reliable else 'best effort'} QoS, as its publishers offer"
            for one in self.inputs.values()
            if one.adapt()
        ]

    def statistics(self) -> dict[str, TopicStatistics]:
        """Current statistics of each topic."""
        queue, rates = self._queue, self._rates()
        waiting: Counter[str] = Counter() if queue is None else queue.waiting()
        late = self._late if queue is None else queue.late()
        return {
            name: TopicStatistics(
                waiting=waiting[name], late=late[name], reliable=one.reliable, rate_hz=rates.get(name, 0.0)
            )
            for name, one in self.inputs.items()
        }

    def destroy(self) -> None:
        """End all subscriptions."""
        for one in self.inputs.values():
            one.destroy()

    def _receive(self, arrival: Arrival) -> None:
        self._arrived[arrival.topic] += 1
        queue = self._queue
        if queue is not None:
            queue.put(arrival)

    def _rates(self) -> dict[str, float]:
        if len(self._ticks) < 2:
            return {}
        (first_s, first), (last_s, last) = self._ticks[0], self._ticks[-1]
        return {name: (last[name] - first[name]) / (last_s - first_s) for name in last}
