# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that receive serialised messages, with the reliability that the publishers offer.

A reliable subscriber receives nothing from a best-effort publisher. Therefore every subscription starts reliable, is
replaced by one with best effort as soon as a publisher on its topic offers no more, and by a reliable one when all
publishers are reliable again. A parameter `qos_overrides.<topic>.subscription.reliability` overrides that: the
subscription is then as the parameter demands, and a publisher that offers less is reported.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from foretouch.ros.runtime.diagnostics import Losses

_ADAPTED = QoSPolicyKind.RELIABILITY
_OVERRIDDEN = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)


@dataclass(frozen=True)
class InputTopic:
    """A topic whose serialised messages are received."""

    name: str  # before remapping, which may be relative to the namespace
    message: type  # class of its messages
    depth: int  # queue size of the middleware

    @property
    def type_name(self) -> str:
        """Name of the type, such as `sensor_msgs/msg/PointCloud2`."""
        module = self.message.__module__.split(".")
        return f"{module[0]}/{module[1]}/{self.message.__name__}"


@dataclass(frozen=True, slots=True)
class SerializedMessage:
    """A message as it was received."""

    topic: str  # full name
    data: bytes  # CDR
    received_ns: int  # when the middleware received it [ns]
    sent_ns: int  # when it was published [ns]
    sequence: int | None  # sequence number of its publisher; None where the middleware has none


class SerializedInput:
    """The subscription to one topic.

    Args:
        node: The subscriber.
        topic: The topic.
        receive: Called with every message, in a thread of the executor; must return at once.
        mismatch: Called with topic, `publisher` and event where a publisher offers less than a parameter demands.
        reliable: What it begins with, before it has adapted.

    Attributes:
        name: Full name of the topic.
        reliable: Whether lost messages are sent again.
        losses: Messages that the middleware has lost.
    """

    def __init__(
        self,
        node: Node,
        topic: InputTopic,
        receive: Callable[[SerializedMessage], None],
        mismatch: Callable[[str, str, Any], None],
        *,
        reliable: bool = True,
    ) -> None:
        self.topic = topic
        self.name: str = node.resolve_topic_name(topic.name)
        self.reliable = reliable
        self.losses = Losses()
        self._node = node
        self._forward = receive
        self._mismatch = mismatch
        override = f"qos_overrides.{self.name}.subscription.{_ADAPTED.name.lower()}"
        self._overridden = override in getattr(node, "_parameter_overrides", {})
        self._group = MutuallyExclusiveCallbackGroup()
        self._subscription = self._subscribe()

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
                incompatible_qos=self._report_mismatch,
                message_lost=lambda event: self.losses.reported(event.total_count_change),
                use_default_callbacks=False,
            ),
            raw=True,
        )
        self.reliable = profile.reliability == ReliabilityPolicy.RELIABLE  # overrides were written into it
        return subscription

    def _report_mismatch(self, event: Any) -> None:
        if self._overridden:  # otherwise `adapt` handles it
            self._mismatch(self.topic.name, "publisher", event)

    def _receive(self, data: bytes, info: Any) -> None:
        if self.losses.arrived(info):  # else it was received before the subscription was replaced
            times = info["received_timestamp"], info["source_timestamp"]
            self._forward(SerializedMessage(self.name, data, *times, info.get("publication_sequence_number")))
