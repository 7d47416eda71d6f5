# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that follow the QoS of their publishers, and count what is lost on the way.

A reliable subscription receives nothing from a best-effort publisher, and best effort loses most large messages of a reliable
one. So a subscription is reliable where every publisher on its topic is, else best effort, and is replaced when that changes. The
same holds for durability where a latched message is wanted. `qos_overrides.<topic>.subscription.<policy>` sets a policy for good.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from foretouch.errors import ConfigError

_LARGEST_GAP: Final = 10_000_000  # messages that one silence may cost: hours at 1 kHz
_FOLLOW: Final = "best_available"  # ROS's own name for the policy that follows the publishers
_REMEMBERED: Final = 200  # latest messages that are recognised when a new subscription brings them again

# Policy that is offered where all publishers offer it, and the one that every publisher is compatible with.
_RELIABILITY: Final = (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)
_DURABILITY: Final = (DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE)


class Losses:
    """Counts the messages of one subscription that were lost before they arrived.

    Numbers of messages have gaps where the network lost some, or a newer message has replaced some in the queue of the middleware.
    They can be used where the publisher of a message is known, or there is only one. Else the losses that the middleware
    reports are counted.

    Args:
        report: Called with the number of messages at each loss.
    """

    def __init__(self, report: Callable[[int], None] = lambda _: None) -> None:
        self.count = 0
        self._report = report
        self._last: dict[bytes, int] = {}  # number of the latest message by publisher
        self._numbered = False  # whether losses show in the numbers

    def arrived(self, info: Any, publishers: int) -> None:
        """Count what is missing before a message.

        Args:
            info: What rclpy passes beside the message.
            publishers: Number of publishers of the topic.
        """
        gid, number = info.get("publisher_gid"), info.get("publication_sequence_number")
        self._numbered = number is not None and (gid is not None or publishers == 1)
        if not self._numbered:
            self._last.clear()
            return
        publisher = b"" if gid is None else bytes(gid["data"])
        step = number - self._last.get(publisher, number - 1)
        self._last[publisher] = number
        if 1 < step <= _LARGEST_GAP:  # else the publisher has started again
            self._lose(step - 1)

    def reported(self, event: Any) -> None:
        """Count a loss that the middleware reports (`QoSMessageLostInfo`), unless it shows in the numbers."""
        if not self._numbered:
            self._lose(event.total_count_change)

    def _lose(self, count: int) -> None:
        self.count += count
        self._report(count)


@dataclass(frozen=True)
class InputTopic:
    """A topic to subscribe to."""

    name: str  # before remapping, which may be relative to the namespace
    message: type  # class of its messages
    depth: int = 5  # number of messages that may wait in the middleware
    # Whether to ask for the last messages of the publishers (transient local): True, False, or None for where all offer it.
    latched: bool | None = False
    raw: bool = False  # whether messages are received as `SerializedMessage`


@dataclass(frozen=True, slots=True)
class SerializedMessage:
    """A message as it was received."""

    topic: str  # full name
    data: bytes  # CDR
    received_ns: int  # when the middleware received it [ns]
    sent_ns: int  # when it was published [ns]
    sequence: int | None  # sequence number of its publisher; None where the middleware has none


class FollowingSubscription:
    """A subscription of a node that follows its publishers each time `follow` is called.

    Args:
        node: The node.
        topic: What to subscribe to.
        receive: Called with each message.
        fail: Called with the name of the topic and an error of `receive`.
        group: Callback group.
        lose: Called with the number of messages at each loss.

    Raises:
        ConfigError: If an override names no policy.
    """

    def __init__(
        self,
        node: Node,
        topic: InputTopic,
        receive: Callable[[Any], None],
        fail: Callable[[str, Exception], object],
        group: CallbackGroup,
        lose: Callable[[int], None],
    ) -> None:
        self.topic = topic
        self.name: str = node.resolve_topic_name(topic.name)
        self.losses = Losses(lose)
        self.excluded: list[str] = []  # a line for each other type of publishers, that nothing is received from
        self._node = node
        self._receive, self._fail = receive, fail
        self._group = group
        durability = _FOLLOW if topic.latched is None else "transient_local" if topic.latched else "volatile"
        self._reliability = self._policy("reliability", ReliabilityPolicy, _FOLLOW)
        self._durability = self._policy("durability", DurabilityPolicy, durability)
        self._wanted = self._compatible()
        self._recent: deque[tuple[int, int | None]] = deque(maxlen=_REMEMBERED)
        self._known: frozenset[tuple[int, int | None]] = frozenset()  # that a new subscription may bring again
        self._subscription = self._subscribe()

    @property
    def reliable(self) -> bool:
        """Whether lost messages are sent again."""
        return self._wanted[0] == ReliabilityPolicy.RELIABLE

    def follow(self) -> list[str]:
        """Replace the subscription if its publishers offer something else than it asks for; gives a line for each news."""
        before, wanted = self.excluded, self._compatible()
        news = [text for text in self.excluded if text not in before]
        if wanted == self._wanted:
            return news
        old = self._subscription
        self._wanted = wanted
        self._known = frozenset(self._recent)
        self._subscription = self._subscribe()
        self._node.destroy_subscription(old)
        policy = "reliable" if self.reliable else "best effort"
        return [*news, f"{self.name}: subscribed with {policy} QoS, as its publishers offer"]

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _policy(self, name: str, kind: Any, default: str) -> Any:
        """Read the override of a policy, None for one that follows the publishers."""
        parameter = f"qos_overrides.{self.name}.subscription.{name}"
        if self._node.has_parameter(parameter):
            value = self._node.get_parameter(parameter).value
        else:
            value = self._node.declare_parameter(parameter, default, ParameterDescriptor(read_only=True)).value
        if value == _FOLLOW:
            return None
        if value not in kind.short_keys():
            raise ConfigError(f"{parameter}: {value!r} is not one of {', '.join(kind.short_keys())}")
        return kind.get_from_short_key(value)

    def _compatible(self) -> tuple[Any, Any]:
        """Look at the publishers; gives reliability and durability to ask for now: the better where all offer it."""
        ends = self._node.get_publishers_info_by_topic(self.name)
        own, kinds = type_name(self.topic.message), {end.topic_type for end in ends}
        rule = f"not {own}: nothing is received from it"
        self.excluded = [f"{self.name}: a publisher sends {kind}, {rule}" for kind in sorted(kinds - {own})]
        reliable = all(end.qos_profile.reliability == _RELIABILITY[0] for end in ends)
        latched = bool(ends) and all(end.qos_profile.durability == _DURABILITY[0] for end in ends)
        return (
            _RELIABILITY[not reliable] if self._reliability is None else self._reliability,
            _DURABILITY[not latched] if self._durability is None else self._durability,
        )

    def _subscribe(self) -> Any:
        reliability, durability = self._wanted
        return self._node.create_subscription(
            self.topic.message,
            self.name,
            self._take,
            QoSProfile(depth=self.topic.depth, reliability=reliability, durability=durability),
            callback_group=self._group,
            qos_overriding_options=QoSOverridingOptions([QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH]),
            event_callbacks=SubscriptionEventCallbacks(message_lost=self.losses.reported, use_default_callbacks=False),
            raw=self.topic.raw,
        )

    def _take(self, message: Any, info: Any) -> None:
        key = info["source_timestamp"], info.get("publication_sequence_number")
        if key in self._known:
            return
        self._recent.append(key)
        self.losses.arrived(info, self._subscription.get_publisher_count())
        if self.topic.raw:
            message = SerializedMessage(self.name, message, info["received_timestamp"], *key)
        try:
            self._receive(message)
        except Exception as err:  # noqa: BLE001  it would end the process
            self._fail(self.topic.name, err)


def type_name(message: type) -> str:
    """Name the type of a message class, such as `sensor_msgs/msg/PointCloud2`."""
    module = message.__module__.split(".")
    return f"{module[0]}/{module[1]}/{message.__name__}"
