# SPDX-License-Identifier: Apache-2.0
"""What became of every cloud: answered, dropped with a named reason, or unexplained. Pure functions, no ROS."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

STAGES = (("perception", ("touch",)),)
"""Node and the topics of its answer, in the order of a chain."""

_SOURCES = {"perception": ("camera",)}
"""Nodes whose messages another one requires."""

QUEUED_S = 2.0  # a node that ends takes along what arrived so shortly before
MATCHED_S = 2.0  # an active node is found by its publishers within this time; one that was killed before, after 1.6 s
COUNTED_S = 5.0  # a drop is counted and reported this long after the cloud at most


@dataclass(frozen=True)
class Outage:
    """A time in which a node could not answer, since it was killed, stopped or deactivated on purpose."""

    node: str
    reason: str
    start_s: float
    end_s: float

    def covers(self, time_s: float) -> bool:
        """Return whether a cloud of this time may be lost to it."""
        return self.start_s - QUEUED_S <= time_s <= self.end_s + MATCHED_S


@dataclass(frozen=True)
class Drop:
    """Drops that a node counted between two of its reports."""

    node: str
    reason: str
    count: int
    start_s: float  # time of the report before
    end_s: float  # time of the report


def account(
    clouds: Mapping[int, float], outputs: Mapping[str, Iterable[int]], outages: Sequence[Outage], drops: Sequence[Drop]
) -> tuple[Counter[str], list[tuple[int, str]]]:
    """Explain every cloud.

    Args:
        clouds: Time at which each cloud was seen [s], by stamp [ns].
        outputs: Stamps [ns] of the messages of each topic in `STAGES`.
        outages: What was done to the nodes. One of a node also explains what the next one did not get from it.
        drops: What the nodes have counted, and what the observer has missed itself.

    Returns:
        Number of clouds by fate: `answered`, `dropped by NODE: REASON`, or `unexplained at NODE`; and the unexplained
        clouds with their node.
    """
    seen = {topic: set(stamps) for topic, stamps in outputs.items()}
    left = [[drop] * drop.count for drop in sorted(drops, key=lambda drop: drop.end_s)]
    fates: Counter[str] = Counter()
    unexplained = []
    for stamp, time_s in sorted(clouds.items(), key=lambda item: item[1]):
        if stamp in seen["touch"]:
            fates["answered"] += 1
            continue
        node = next(node for node, topics in STAGES if any(stamp not in seen[topic] for topic in topics))
        counted = next((equal for equal in left if equal and _explains(equal[0], node, time_s)), None)
        outage = next((cause for cause in outages if cause.node == node and cause.covers(time_s)), None)
        source = next((cause for cause in outages if cause.node in _SOURCES[node] and cause.covers(time_s)), None)
        if outage:  # before a drop, which is left for the cloud that was counted
            fates[f"dropped by {node}: {outage.reason}"] += 1
        elif counted:
            fates[f"dropped by {node}: {counted.pop().reason}"] += 1  # each explains one cloud
        elif source:  # what it sent last is lost with it, and what it sends first before the other has found it
            fates[f"dropped by {node}: {source.node} {source.reason}"] += 1
        else:
            fates[f"unexplained at {node}"] += 1
            unexplained.append((stamp, node))
    return fates, unexplained


def _explains(drop: Drop, node: str, time_s: float) -> bool:
    return drop.node == node and drop.end_s >= time_s and drop.start_s <= time_s + COUNTED_S
