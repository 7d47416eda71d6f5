# SPDX-License-Identifier: Apache-2.0
"""What discovery shows of a graph: a second graph in its namespace, and who publishes and hears what.

A participant of another program may be seen up to three seconds late, when its next announcement is due. A process that was
killed is listed until its lease has expired: 20 s with the default of Fast DDS. A shorter lease is no remedy: after an
interruption that is longer, the names of nodes stay unknown to each other.
"""

from collections.abc import Iterable
from typing import Any

from rclpy.node import Node

# Nodes that answer clouds, or show the answers.
_GRAPH = ("perception", "segmentation", "grasp", "touch_predictor", "replay", "monitor")


def find_conflicts(node: Node, topics: Iterable[str]) -> tuple[str, ...]:
    """Look for signs of a second graph in the namespace, which answers every cloud once more without any error; a line each.

    Args:
        node: Of the first graph.
        topics: Each should have one publisher at most. To look takes less than 0.1 ms a topic.
    """
    own = node.get_fully_qualified_name()
    count = sum(_full_name(*namespace) == own for namespace in node.get_node_names_and_namespaces())
    conflicts = [f"{count} nodes are named {own}"] if count > 1 else []
    for topic in map(node.resolve_topic_name, topics):
        names = publishers_of(node, topic)
        if len(names) > 1 and set(names) != {own}:
            conflicts.append(f"{topic} has {len(names)} publishers: {', '.join(names)}")
    return tuple(conflicts)


def publishers_of(node: Node, topic: str) -> list[str]:
    """List the full names of the nodes that publish a topic, as far as they are discovered."""
    ends = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return sorted(_name_of(end) for end in ends if end.node_name != "_NODE_NAME_UNKNOWN_")


def is_heard_outside(node: Node, topic: str) -> bool:
    """Return whether a topic, by its full name, has a subscriber that is neither a node which answers clouds nor the display."""
    graph = {_full_name(name, node.get_namespace()) for name in _GRAPH}
    return not graph.issuperset(map(_name_of, node.get_subscriptions_info_by_topic(topic)))


def ends_of_topics(node: Node) -> list[tuple[str, int, int]]:
    """Count the publishers and the subscribers of every topic that is seen."""
    topics = sorted(name for name, _ in node.get_topic_names_and_types())
    return [(name, node.count_publishers(name), node.count_subscribers(name)) for name in topics]


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _name_of(end: Any) -> str:
    return _full_name(end.node_name, end.node_namespace)
