# SPDX-License-Identifier: Apache-2.0
"""What discovery shows of a graph: a second graph in its namespace, and whether publishers and subscribers are matched.

Each node reports in /diagnostics how long it has run and how many ends of its topics are matched (`matched_ends`). A source
of clouds compares that with the ends that discovery shows. A participant of another program may be seen up to three seconds
late, when its next announcement is due. A process that was killed is listed until its lease has expired: 20 s with the
default of Fast DDS.
"""

import time
from collections.abc import Callable, Iterable, Mapping
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


def find_conflicts(node: Node, topics: Iterable[str], is_silent: Callable[[bytes], bool]) -> tuple[str, ...]:
    """Signs of a second graph in the namespace, which answers every cloud once more without any error, a line each.

    Each of the topics should have one publisher at most. `is_silent` says whether the process of an end, by its id, has
    ended: such are still listed for some seconds. To look takes less than 0.1 ms a topic.
    """
    own = node.get_fully_qualified_name()
    count = sum(_full_name(name, space) == own for name, space in node.get_node_names_and_namespaces())
    found = [f"{count} nodes are named {own}"] if count > 1 else []
    for topic in map(node.resolve_topic_name, topics):
        ends = [end for end in node.get_publishers_info_by_topic(topic) if not is_silent(bytes(end.endpoint_gid))]
        # An end whose node is not discovered yet has no name.
        names = sorted(_node_of(end) for end in ends if end.node_name != "_NODE_NAME_UNKNOWN_")
        if len(names) > 1 and set(names) != {own}:
            found.append(f"{topic} has {len(names)} publishers: {', '.join(names)}")
    return tuple(found)


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
    """What the nodes of a graph wait for before the first cloud, as one of them sees the graph.

    Every node must have run for `discovery_s` [s], and each topic of `wait_for`, or else a `ConfigError`, needs a subscriber
    that is neither a node which answers clouds nor the display.
    """

    def __init__(self, node: Node, discovery_s: float, wait_for: Iterable[str]) -> None:
        self._node = node
        self._discovery_s = discovery_s
        self._reports: dict[str, tuple[float, dict[str, int]]] = {}  # when it began, and its matched ends
        self._wait_for = []
        for name in wait_for:
            try:
                self._wait_for.append(node.resolve_topic_name(name))
            except RuntimeError as err:  # of rcl
                raise ConfigError(f"wait_for: {name!r} is not a valid topic name") from err

    def receive(self, message: DiagnosticArray) -> None:
        """Keep the report of each node, once it has made its publishers."""
        own = self._names()
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name in own and UPTIME in values and values.get("state") != "unconfigured":
                ends = ((k, int(v)) for k, v in values.items() if k.startswith((_SUBSCRIBERS, _PUBLISHERS)))
                self.report(status.name, float(values[UPTIME]), dict(ends))

    def report(self, name: str, uptime_s: float, ends: Mapping[str, int]) -> None:
        """Keep what is known of a node, by its full name."""
        self._reports[name] = (time.monotonic() - uptime_s, dict(ends))

    def is_discovered(self) -> bool:
        """Whether every node has run for long enough."""
        return all(time.monotonic() - began >= self._discovery_s for began, _ in dict(self._reports).values())

    def missing(self) -> list[str]:
        """What is not matched, of what is seen, a few words each."""
        node, reports, own = self._node, dict(self._reports), self._names()
        found = [
            f"{topic}: no subscriber"
            for topic in self._wait_for
            if own.issuperset(map(_node_of, node.get_subscriptions_info_by_topic(topic)))
        ]
        reporting = set(map(_node_of, node.get_publishers_info_by_topic("/diagnostics")))
        found += [f"{name}: no report in /diagnostics" for name in sorted(own & reporting - reports.keys())]
        for name, (_, ends) in reports.items():
            for key, count in ends.items():
                other, _, topic = key.partition(".")
                wanted = self._compatible(name, topic, _SUBSCRIBERS.startswith(other))
                if count < wanted:
                    found.append(f"{topic}: {wanted - count} of {wanted} {other.removeprefix('matched_')} of {name}")
        return found

    def _names(self) -> set[str]:
        space = self._node.get_namespace()
        return {_full_name(name, space) for name in _GRAPH} | {self._node.get_fully_qualified_name()}

    def _compatible(self, name: str, topic: str, is_publisher: bool) -> int:
        """How many ends a node's end of a topic must match, as far as discovery shows."""
        ends = self._node.get_publishers_info_by_topic(topic), self._node.get_subscriptions_info_by_topic(topic)
        mine, others = ends if is_publisher else ends[::-1]
        if (one := next((end for end in mine if _node_of(end) == name), None)) is None:
            return 0
        pairs = ((one, end) if is_publisher else (end, one) for end in others if end.topic_type == one.topic_type)
        checks = (qos_check_compatible(sent.qos_profile, heard.qos_profile)[0] for sent, heard in pairs)
        return sum(check != QoSCompatibility.ERROR for check in checks)


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _node_of(end: Any) -> str:
    return _full_name(end.node_name, end.node_namespace)
