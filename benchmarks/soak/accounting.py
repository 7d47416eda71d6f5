# SPDX-License-Identifier: Apache-2.0
"""What became of every cloud: answered, dropped with a named reason, or unexplained. Pure functions, no ROS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

STAGES = (("segmentation", ("object_cloud", "table")), ("grasp", ("grasps",)), ("touch_predictor", ("touch",)))
"""Node and the topics of its answer, in the order of the chain."""

QUEUED_S = 2.0  # a node that ends takes along what arrived so shortly before
MATCHED_S = 1.0  # an active node is found by its publishers within this time
COUNTED_S = 20.0  # a drop is counted this long after the cloud at most: `unpaired` waits for other clouds


@dataclass(frozen=True)
class Outage:
    """A time in which a node could not answer, since it was killed, stopped or deactivated on purpose."""

    node: str
    reason: str
    start_s: float
    end_s: float

    def covers(self, time_s: float) -> bool:
        """Whether a cloud of this time may be lost to it."""
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
        outages: What was done to the nodes.
        drops: What the nodes have counted.

    Returns:
        Number of clouds by fate: `answered`, `dropped by NODE: REASON`, or `unexplained at NODE`; and the unexplained
        clouds with their node.
    """
    seen = {topic: set(stamps) for topic, stamps in outputs.items()}
    left = [[drop, drop.count] for drop in sorted(drops, key=lambda one: one.end_s)]
    fates: Counter[str] = Counter()
    unexplained = []
    for stamp, time_s in sorted(clouds.items(), key=lambda item: item[1]):
        node = _lost_at(stamp, seen)
        if node is None:
            fates["answered"] += 1
            continue
        reason = _counted(node, time_s, left) or next(
            (one.reason for one in outages if one.node == node and one.covers(time_s)), None
        )
        if reason is None:
            unexplained.append((stamp, node))
        fates[f"unexplained at {node}" if reason is None else f"dropped by {node}: {reason}"] += 1
    return fates, unexplained


def _lost_at(stamp: int, seen: Mapping[str, set[int]]) -> str | None:
    """The first node of the chain that did not answer; None for a cloud with an answer at the end."""
    if stamp in seen["touch"]:
        return None
    return next(node for node, topics in STAGES if any(stamp not in seen[topic] for topic in topics))


def _counted(node: str, time_s: float, left: list[list[object]]) -> str | None:
    """The reason of a drop that the node counted at about this time; each is used once."""
    for entry in left:
        drop, count = entry
        assert isinstance(drop, Drop)
        assert isinstance(count, int)
        if drop.node == node and count and drop.end_s >= time_s and drop.start_s <= time_s + COUNTED_S:
            entry[1] = count - 1
            return drop.reason
    return None


def slope_per_hour(times_s: Sequence[float], values: Sequence[float]) -> float:
    """Slope of a least-squares line through values over time [value/h]; NaN for fewer than three."""
    import numpy as np

    if len(times_s) < 3:
        return float("nan")
    return float(np.polyfit(np.asarray(times_s) / 3600.0, np.asarray(values), 1)[0])
