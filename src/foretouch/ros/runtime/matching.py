# SPDX-License-Identifier: Apache-2.0
"""Whether the publishers and subscribers of a graph have found each other, so that no answer is lost at the start.

Each node reports in /diagnostics how long it has run and how many ends of its topics are matched (`matched_ends`). A source
of clouds compares that with the ends that discovery shows. A participant of another program may be seen up to three seconds
late, when its next announcement is due.
"""

import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription

from foretouch.errors import ConfigError

UPTIME: Final = "uptime_s"
_SUBSCRIBERS, _PUBLISHERS = "matched_subscribers.", "matched_publishers."
_GRAPH: Final = frozenset({"segmentation", "grasp", "touch_predictor", "replay", "monitor"})  # see `Matching`


def matched_ends(
    publishers: Iterable["Publisher[Any]"], subscriptions: Iterable["Subscription[Any]"]
) -> dict[str, int]:
    """Number of matched ends on the other side of each topic, by key of /diagnostics."""
    found = {}
    with suppress(InvalidHandle):  # destroyed meanwhile
        for publisher in publishers:
            found[_SUBSCRIBERS + publisher.topic_name] = int(publisher.get_subscription_count())
        for subscription in subscriptions:
            found[_PUBLISHERS + subscription.topic_name] = int(subscription.get_publisher_count())
    return found


class Matching:
    """What the nodes of a graph wait for before the first cloud.

    Args:
        node: A node of the graph, whose view of it is used.
        discovery_s: Time that every node must have run [s].
        wait_for: Names of topics that need a subscriber that is neither a node which answers clouds nor the display.

    Raises:
        ConfigError: If one is no name of a topic.
    """

    def __init__(self, node: Node, discovery_s: float, wait_for: Iterable[str]) -> None:
        self._node = node
        self._discovery_s = discovery_s
        self._wait_for = tuple(_resolved(node, name) for name in wait_for)
        self._reports: dict[str, tuple[float, dict[str, int]]] = {}  # when it began, and its matched ends

    def receive(self, message: DiagnosticArray) -> None:
        """Keep the report of each node, once it has made its publishers."""
        own = self._names()
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name in own and UPTIME in values and values.get("state") != "unconfigured":
                ends = {k: int(v) for k, v in values.items() if k.startswith((_SUBSCRIBERS, _PUBLISHERS))}
                self.report(status.name, float(values[UPTIME]), ends)

    def report(self, name: str, uptime_s: float, ends: Mapping[str, int]) -> None:
        """Keep what is known of a node, by its full name."""
        self._reports[name] = (time.monotonic() - uptime_s, dict(ends))

    def is_discovered(self) -> bool:
        """Whether every node has run for long enough."""
        return all(time.monotonic() - began >= self._discovery_s for began, _ in dict(self._reports).values())

    def missing(self) -> list[str]:
        """What is not matched, of what is seen, a few words each."""
        reports, own = dict(self._reports), self._names()
        found = [f"{topic}: no subscriber" for topic in self._wait_for if not self._is_heard(topic, own)]
        silent = sorted(own & self._reporting() - reports.keys())
        found += [f"{name}: no report in /diagnostics" for name in silent]
        for name, (_, ends) in reports.items():
            for key, count in ends.items():
                other, _, topic = key.partition(".")
                wanted = self._compatible(name, topic, _SUBSCRIBERS.startswith(other))
                if count < wanted:
                    found.append(f"{topic}: {wanted - count} of {wanted} {other.removeprefix('matched_')} of {name}")
        return found

    def _names(self) -> set[str]:
        space = self._node.get_namespace().rstrip("/")
        return {f"{space}/{name}" for name in _GRAPH} | {self._node.get_fully_qualified_name()}

    def _reporting(self) -> set[str]:
        return set(map(_name_of, self._node.get_publishers_info_by_topic("/diagnostics")))

    def _is_heard(self, topic: str, own: set[str]) -> bool:
        return any(_name_of(end) not in own for end in self._node.get_subscriptions_info_by_topic(topic))

    def _compatible(self, name: str, topic: str, is_publisher: bool) -> int:
        """How many ends a node's end of a topic must match, as far as discovery shows."""
        ends = self._node.get_publishers_info_by_topic(topic), self._node.get_subscriptions_info_by_topic(topic)
        mine, others = ends if is_publisher else ends[::-1]
        one = next((end for end in mine if _name_of(end) == name), None)
        if one is None:
            return 0
        pairs = ((one, end) if is_publisher else (end, one) for end in others if end.topic_type == one.topic_type)
        checks = (qos_check_compatible(sent.qos_profile, heard.qos_profile)[0] for sent, heard in pairs)
        return sum(check != QoSCompatibility.ERROR for check in checks)


def _resolved(node: Node, topic: str) -> str:
    try:
        return node.resolve_topic_name(topic)
    except RuntimeError as err:  # of rcl
        raise ConfigError(f"wait_for: {topic!r} is no name of a topic") from err


def _name_of(end: Any) -> str:
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"
