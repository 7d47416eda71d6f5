# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of the recorder: serialised messages, reliable wherever that is offered, and what was lost on the way.

A reliable subscriber gets nothing from a best-effort publisher. So every input begins reliable, and is made anew with
best effort as soon as a publisher on its topic offers no more; it is made reliable again when all do. A parameter
`qos_overrides.<topic>.subscription.reliability` ends that: then the input is what the parameter says, and a publisher
that offers less is told of.

All inputs of the recorder: what arrives goes into the inbox of the session at hand, and how much is known of it.
"""

from __future__ import annotations

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

__all__ = ["InputTopic", "RecorderInput", "RecorderSubscriptions"]


_ADAPTED = QoSPolicyKind.RELIABILITY
_OVERRIDDEN = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)


@dataclass(frozen=True)
class InputTopic:
    """A topic to record.

    Attributes:
        name: As it is subscribed to: relative to the namespace, and before remapping.
        message: Class of its messages.
        depth: Messages that the middleware may hold for us.
    """

    name: str
    message: type
    depth: int

    @property
    def type_name(self) -> str:
        """Such as `sensor_msgs/msg/PointCloud2`."""
        module = self.message.__module__.split(".")
        return f"{module[0]}/{module[1]}/{self.message.__name__}"


class RecorderInput:
    """One topic.

    Args:
        node: Subscribes.
        topic: What to.
        take: Called with every message, in a thread of the executor; must return at once.
        mismatch: Told of topic, `publisher` and event where a publisher offers less than a parameter asks for.

    Attributes:
        name: Full name of the topic.
        reliable: Whether lost messages are sent again.
    """

    def __init__(
        self,
        node: Node,
        topic: InputTopic,
        take: Callable[[Arrival], None],
        mismatch: Callable[[str, str, Any], None],
    ) -> None:
        self.topic = topic
        self.name: str = node.resolve_topic_name(topic.name)
        self.reliable = True
        self._node = node
        self._take = take
        self._mismatch = mismatch
        wish = f"qos_overrides.{self.name}.subscription.{_ADAPTED.name.lower()}"
        self._pinned = wish in getattr(node, "_parameter_overrides", {})
        self._lock = threading.Lock()
        self._last: dict[bytes, int] = {}
        self._gaps = 0
        self._events = 0
        self._group = MutuallyExclusiveCallbackGroup()
        self._subscription = self._subscribe()

    @property
    def lost(self) -> int:
        """Messages since `reset` that the middleware lost: gaps in the publishers' numbers, or its own events."""
        with self._lock:
            return max(self._gaps, self._events)

    def reset(self) -> None:
        """Count what is lost from now on."""
        with self._lock:
            self._gaps = self._events = 0

    def adapt(self) -> bool:
        """Look at what the publishers offer; whether the subscription was made anew."""
        if self._pinned:
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
        """Listen no more."""
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
            qos_overriding_options=QoSOverridingOptions((*_OVERRIDDEN, *[_ADAPTED] * self._pinned)),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=self._differ, message_lost=self._lose, use_default_callbacks=False
            ),
            raw=True,
        )
        self.reliable = profile.reliability == ReliabilityPolicy.RELIABLE  # overrides were written into it
        return subscription

    def _differ(self, event: Any) -> None:
        if self._pinned:  # else `adapt` sees to it
            self._mismatch(self.topic.name, "publisher", event)

    def _receive(self, data: bytes, info: Any) -> None:
        sequence = info.get("publication_sequence_number")
        publisher = info.get("publisher_gid")
        if sequence is not None and publisher is not None and not self._follow(publisher["data"], sequence):
            return
        self._take(Arrival(self.name, data, info["received_timestamp"], info["source_timestamp"], sequence))

    def _follow(self, publisher: bytes, sequence: int) -> bool:
        """Count what is missing; False for a message that the subscription made anew has received once more."""
        with self._lock:
            last = self._last.get(publisher)
            if last is not None and sequence <= last:
                return False
            self._gaps += 0 if last is None else sequence - last - 1
            self._last[publisher] = sequence
            return True

    def _lose(self, event: Any) -> None:
        with self._lock:
            self._events += event.total_count_change


_RATE_TICKS = 11


class RecorderSubscriptions:
    """Subscribes to all topics; without a session, what arrives is only counted.

    Args:
        node: Subscribes.
        topics: What to.
        mismatch: See `RecorderInput`.

    Attributes:
        inputs: By full name.
    """

    def __init__(self, node: Node, topics: Sequence[InputTopic], mismatch: Callable[[str, str, Any], None]) -> None:
        self.inputs: dict[str, RecorderInput] = {}
        self._names: dict[str, str] = {}
        self._inbox: MessageQueue | None = None
        self._late: Counter[str] = Counter()
        self._arrived: Counter[str] = Counter()
        self._ticks: deque[tuple[float, Counter[str]]] = deque(maxlen=_RATE_TICKS)
        try:
            for topic in topics:
                one = RecorderInput(node, topic, self._take, mismatch)
                self.inputs[one.name], self._names[topic.name] = one, one.name
        except BaseException:  # such as an override that names no policy
            self.destroy()
            raise

    def name(self, relative: str) -> str:
        """The full name of a topic, as it was subscribed to."""
        return self._names[relative]

    def open(self, inbox: MessageQueue) -> None:
        """A session begins: count what is lost from now on, and put what arrives into its inbox."""
        for one in self.inputs.values():
            one.reset()
        self._late.clear()
        self._inbox = inbox

    def close(self) -> None:
        """The session is over."""
        inbox, self._inbox = self._inbox, None
        if inbox is not None:
            self._late = inbox.late()

    def lost(self) -> dict[str, int]:
        """What the middleware has lost since `open`, by topic."""
        return {name: one.lost for name, one in self.inputs.items()}

    def tick(self) -> list[str]:
        """Look at the clock and at what the publishers offer; tells of subscriptions that were made anew."""
        self._ticks.append((time.monotonic(), Counter(self._arrived)))
        return [
            f"{one.name}: is offered {'reliable' if one.reliable else 'best effort'}, and subscribed to likewise"
            for one in self.inputs.values()
            if one.adapt()
        ]

    def inflows(self) -> dict[str, TopicStatistics]:
        """What is known of each topic now."""
        inbox, rates = self._inbox, self._rates()
        waiting: Counter[str] = Counter() if inbox is None else inbox.waiting()
        late = self._late if inbox is None else inbox.late()
        return {
            name: TopicStatistics(
                waiting=waiting[name], late=late[name], reliable=one.reliable, rate_hz=rates.get(name, 0.0)
            )
            for name, one in self.inputs.items()
        }

    def destroy(self) -> None:
        """Listen no more."""
        for one in self.inputs.values():
            one.destroy()

    def _take(self, arrival: Arrival) -> None:
        self._arrived[arrival.topic] += 1
        inbox = self._inbox
        if inbox is not None:
            inbox.put(arrival)

    def _rates(self) -> dict[str, float]:
        if len(self._ticks) < 2:
            return {}
        (first_s, first), (last_s, last) = self._ticks[0], self._ticks[-1]
        return {name: (last[name] - first[name]) / (last_s - first_s) for name in last}
