# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that follow the QoS of their publishers, and count what is lost on the way.

A reliable subscription receives nothing from a best-effort publisher, and best effort loses most large messages of a reliable
one. So a subscription is reliable where every publisher on its topic is, else best effort, and is replaced when that changes. The
same holds for durability where a latched message is wanted. `qos_overrides.<topic>.subscription.<policy>` sets a policy for good.
"""

from collections import deque
from collections.abc import Callable
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
        """Count what is missing before a message, by what rclpy passes beside it and the number of publishers."""
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


class FollowingSubscription:
    """A subscription of a node that follows its publishers each time `follow` is called.

    Args:
        node: The node.
        message: Class of the messages.
        topic: Name of the topic.
        receive: Called with each message and what rclpy passes beside it.
        depth: Number of messages that may wait in the middleware.
        group: Callback group.
        latched: `follow` for transient local where every publisher is; True for always, False for never.
        raw: Whether messages are passed serialised.
        report: Called with the number of messages at each loss.

    Raises:
        ConfigError: If an override names no policy.
    """

    def __init__(
        self,
        node: Node,
        message: type,
        topic: str,
        receive: Callable[[Any, Any], None],
        *,
        depth: int,
        group: CallbackGroup | None = None,
        latched: bool | None = False,
        raw: bool = False,
        report: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.name: str = node.resolve_topic_name(topic)
        self.losses = Losses(report)
        self._node, self._message, self._receive, self._raw, self._group = node, message, receive, raw, group
        self._depth = depth
        durability = _FOLLOW if latched is None else ("transient_local" if latched else "volatile")
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

    @property
    def publishers(self) -> int:
        """Number of publishers that messages are received from."""
        return int(self._subscription.get_publisher_count())

    def follow(self) -> bool:
        """Replace the subscription if its publishers offer something else than it asks for; returns whether it was."""
        if (wanted := self._compatible()) == self._wanted:
            return False
        old, self._wanted, self._known = self._subscription, wanted, frozenset(self._recent)
        self._subscription = self._subscribe()
        self._node.destroy_subscription(old)
        return True

    def excluded(self) -> list[str]:
        """A line for each other type of publishers that nothing is received from, such as those of another sensor."""
        kinds = {end.topic_type for end in self._node.get_publishers_info_by_topic(self.name)}
        own = type_name(self._message)
        rule = f"not {own}: nothing is received from it"
        return [f"{self.name}: a publisher sends {kind}, {rule}" for kind in sorted(kinds - {own})]

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
        """Reliability and durability to ask for now: the better where all publishers offer it."""
        offers = [end.qos_profile for end in self._node.get_publishers_info_by_topic(self.name)]
        reliable = all(offer.reliability == _RELIABILITY[0] for offer in offers)
        latched = bool(offers) and all(offer.durability == _DURABILITY[0] for offer in offers)
        return (
            _RELIABILITY[not reliable] if self._reliability is None else self._reliability,
            _DURABILITY[not latched] if self._durability is None else self._durability,
        )

    def _subscribe(self) -> Any:
        reliability, durability = self._wanted
        return self._node.create_subscription(
            self._message,
            self.name,
            self._take,
            QoSProfile(depth=self._depth, reliability=reliability, durability=durability),
            callback_group=self._group,
            qos_overriding_options=QoSOverridingOptions([QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH]),
            event_callbacks=SubscriptionEventCallbacks(message_lost=self.losses.reported, use_default_callbacks=False),
            raw=self._raw,
        )

    def _take(self, message: Any, info: Any) -> None:
        key = info["source_timestamp"], info.get("publication_sequence_number")
        if key in self._known:
            return
        self._recent.append(key)
        self.losses.arrived(info, self.publishers)
        self._receive(message, info)


def type_name(message: type) -> str:
    """Name the type of a message class, such as `sensor_msgs/msg/PointCloud2`."""
    module = message.__module__.split(".")
    return f"{module[0]}/{module[1]}/{message.__name__}"
