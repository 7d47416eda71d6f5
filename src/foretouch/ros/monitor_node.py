# SPDX-License-Identifier: Apache-2.0
"""Watches a running graph for a person: counts answers, keeps the last one, collects diagnostics.

Its callbacks only store, under a lock; whoever draws takes a copy.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from foretouch.errors import CloudError
from foretouch.pipeline import ASSUMED_TABLE, FoundObject
from foretouch.ros.clouds import cloud_from_msg, objects_from_msg
from foretouch.ros.conversions import stamp_ns
from foretouch.ros.node_base import NAMESPACE
from foretouch.ros.status import status_name
from foretouch.types import Cloud
from foretouch_msgs.msg import TouchPredictionArray

__all__ = ["MonitorNode", "NodeView", "View"]

_KEPT_CLOUDS = 8  # enough to find the cloud of an answer again


@dataclass(frozen=True)
class NodeView:
    """The last report of one node: level, one line, and its numbers by name."""

    level: int
    message: str
    values: dict[str, str]


@dataclass
class View:
    """What is known of the graph at one moment.

    Attributes:
        answers: Arrays of touch received, by status.
        reasons: How often each reason was given.
        last: The last array of touch, or None.
        nodes: Last diagnostics by node name.
    """

    answers: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    last: TouchPredictionArray | None = None
    nodes: dict[str, NodeView] = field(default_factory=dict)


class MonitorNode(Node):
    """Listens to `touch` and /diagnostics, and to the clouds where a picture is wanted.

    Args:
        namespace: Of the graph.
        with_clouds: Whether to keep the last clouds, so that an answer can be drawn.
        on_touch: Called with each array of touch, in the executor's thread.
    """

    def __init__(
        self,
        *,
        namespace: str = NAMESPACE,
        with_clouds: bool = False,
        on_touch: Callable[[TouchPredictionArray], None] | None = None,
        **options: Any,
    ) -> None:
        super().__init__("monitor", namespace=namespace, **options)
        self._lock = threading.Lock()
        self._view = View()
        self._on_touch = on_touch
        self._scenes: OrderedDict[int, PointCloud2] = OrderedDict()
        self._objects: OrderedDict[int, PointCloud2] = OrderedDict()
        self._drawable: deque[TouchPredictionArray] = deque(maxlen=_KEPT_CLOUDS)
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(TouchPredictionArray, "touch", self._take_touch, reliable)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 50)
        if with_clouds:
            for topic, kept in (("points", self._scenes), ("object_cloud", self._objects)):
                self.create_subscription(
                    PointCloud2, topic, lambda message, kept=kept: self._keep(kept, message), qos_profile_sensor_data
                )

    def view(self) -> View:
        """A copy that no callback changes."""
        with self._lock:
            view = self._view
            return View(Counter(view.answers), Counter(view.reasons), view.last, dict(view.nodes))

    def last_drawable(self) -> tuple[Cloud | None, FoundObject, TouchPredictionArray] | None:
        """The newest answer with a prediction whose clouds are still kept: scene, object, answer."""
        with self._lock:
            answers, scenes, objects = list(self._drawable), dict(self._scenes), dict(self._objects)
        for answer in reversed(answers):
            stamp = stamp_ns(answer.header.stamp)
            if stamp not in objects:
                continue
            try:
                found = objects_from_msg(objects[stamp], ASSUMED_TABLE)
                scene = cloud_from_msg(scenes[stamp]) if stamp in scenes else None
            except CloudError:
                continue
            wanted = answer.predictions[0].grasp.object_id
            for one in found:
                if one.id == wanted:
                    return scene, one, answer
        return None

    def _take_touch(self, message: TouchPredictionArray) -> None:
        with self._lock:
            self._view.answers[status_name(message.status)] += 1
            if message.reason:
                self._view.reasons[message.reason] += 1
            self._view.last = message
            if message.predictions:
                self._drawable.append(message)
        if self._on_touch is not None:
            self._on_touch(message)

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        with self._lock:
            for status in message.status:
                values = {pair.key: pair.value for pair in status.values}
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                self._view.nodes[status.name] = NodeView(level, status.message, values)

    def _keep(self, kept: OrderedDict[int, PointCloud2], message: PointCloud2) -> None:
        with self._lock:
            kept[stamp_ns(message.header.stamp)] = message
            while len(kept) > _KEPT_CLOUDS:
                kept.popitem(last=False)
