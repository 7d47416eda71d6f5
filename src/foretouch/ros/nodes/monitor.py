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
from foretouch.ros.messages.clouds import cloud_from_msg, objects_from_msg
from foretouch.ros.messages.conversions import stamp_ns
from foretouch.ros.messages.status import status_name
from foretouch.ros.runtime.lifecycle_node import NAMESPACE
from foretouch.ros.touch.executed import Felt, TactileWindow
from foretouch.types import Cloud
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, TouchPrediction, TouchPredictionArray

__all__ = ["Drawable", "MonitorNode", "NodeView", "View"]

_KEPT_CLOUDS = 8  # enough to find the cloud of an answer again
_KEPT_WHILE_GRASPING = 32  # enough to find it when the grasp has been executed


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
        executed: The last grasp that a hand executed with success: what was predicted, and what was read.
        nodes: Last diagnostics by node name.
    """

    answers: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    last: TouchPredictionArray | None = None
    executed: tuple[TouchPrediction, Felt] | None = None
    nodes: dict[str, NodeView] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Drawable:
    """A prediction with what it was made of.

    Attributes:
        scene: The whole cloud, where it was seen.
        target: The object.
        prediction: The answer.
        felt: What was read when the grasp was executed; None if it was not.
    """

    scene: Cloud | None
    target: FoundObject
    prediction: TouchPrediction
    felt: Felt | None = None


class MonitorNode(Node):
    """Listens to `touch` and /diagnostics, and to the clouds where a picture is wanted.

    Args:
        namespace: Of the graph.
        with_clouds: Whether to keep the last clouds, so that an answer can be drawn.
        with_hand: Whether to listen to a hand, so that what was read can be drawn beside it.
        on_touch: Called with each array of touch, in the executor's thread.
    """

    def __init__(
        self,
        *,
        namespace: str = NAMESPACE,
        with_clouds: bool = False,
        with_hand: bool = False,
        on_touch: Callable[[TouchPredictionArray], None] | None = None,
        **options: Any,
    ) -> None:
        super().__init__("monitor", namespace=namespace, **options)
        self._lock = threading.Lock()
        self._view = View()
        self._on_touch = on_touch
        self._scenes: OrderedDict[int, PointCloud2] = OrderedDict()
        self._objects: OrderedDict[int, PointCloud2] = OrderedDict()
        self._kept = _KEPT_WHILE_GRASPING if with_hand else _KEPT_CLOUDS
        self._drawable: deque[TouchPredictionArray] = deque(maxlen=self._kept)
        self._executed: Drawable | None = None
        self._tactile = TactileWindow()
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(TouchPredictionArray, "touch", self._take_touch, reliable)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 50)
        if with_hand:
            self.create_subscription(BiotacAll, "/rh/tactile", self._tactile.add, reliable)
            self.create_subscription(ExecutedGrasp, "executed_grasp", self._take_executed, reliable)
        if with_clouds:
            for topic, kept in (("points", self._scenes), ("object_cloud", self._objects)):
                self.create_subscription(
                    PointCloud2, topic, lambda message, kept=kept: self._keep(kept, message), qos_profile_sensor_data
                )

    def view(self) -> View:
        """A copy that no callback changes."""
        with self._lock:
            view = self._view
            return View(Counter(view.answers), Counter(view.reasons), view.last, view.executed, dict(view.nodes))

    def last_drawable(self) -> Drawable | None:
        """The last answer whose grasp was executed, else the newest whose clouds are still kept."""
        with self._lock:
            if self._executed is not None:
                return self._executed
            answers = list(self._drawable)
        return next(filter(None, (self._drawn(answer.predictions[0]) for answer in reversed(answers))), None)

    def _drawn(self, prediction: TouchPrediction, felt: Felt | None = None) -> Drawable | None:
        """A prediction with its clouds; None where they are gone."""
        stamp = stamp_ns(prediction.header.stamp)
        with self._lock:
            scene_message, object_message = self._scenes.get(stamp), self._objects.get(stamp)
        if object_message is None:
            return None
        try:
            found = objects_from_msg(object_message, ASSUMED_TABLE)
            scene = None if scene_message is None else cloud_from_msg(scene_message)
        except CloudError:
            return None
        wanted = prediction.grasp.object_id
        return next((Drawable(scene, one, prediction, felt) for one in found if one.id == wanted), None)

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

    def _take_executed(self, report: ExecutedGrasp) -> None:
        felt = self._tactile.felt(report)
        if felt is None:
            return
        with self._lock:
            predictions = [one for answer in self._drawable for one in answer.predictions]
        for one in predictions:
            if one.grasp.id == felt.grasp_id:
                drawn = self._drawn(one, felt)
                with self._lock:
                    self._view.executed = one, felt
                    self._executed = drawn or self._executed

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        with self._lock:
            for status in message.status:
                values = {pair.key: pair.value for pair in status.values}
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                self._view.nodes[status.name] = NodeView(level, status.message, values)

    def _keep(self, kept: OrderedDict[int, PointCloud2], message: PointCloud2) -> None:
        with self._lock:
            kept[stamp_ns(message.header.stamp)] = message
            while len(kept) > self._kept:
                kept.popitem(last=False)
