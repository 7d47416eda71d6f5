# SPDX-License-Identifier: Apache-2.0
"""Watches a running graph for display: counts answers, keeps the last one, collects diagnostics.

Its callbacks only store, under a lock; `view` gives a copy.
"""

import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final, TypeAlias

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Image, PointCloud2

from foretouch.cloud.io.colours import colours_of
from foretouch.cloud.messages import decode_cloud, decode_objects
from foretouch.dataset.labelling.assembler import AssemblerConfig, Role, SampleAssembler
from foretouch.dataset.labelling.buffers import SeenObjects
from foretouch.errors import CloudError, DatasetError, TactileError
from foretouch.ros.messages.requests import read_serialized, status_name
from foretouch.ros.messages.tactile import message_class
from foretouch.ros.runtime.internal_errors import InternalErrors
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileConfig
from foretouch.topics import CLOUD_TOPIC, COLOUR_TOPIC, EXECUTED_TOPIC, NAMESPACE, TACTILE_TOPIC
from foretouch.types import Cloud, Sample, stamp_ns
from foretouch.types.scene import Object
from foretouch_msgs.msg import ExecutedGrasp, TouchPrediction, TouchPredictionArray

_NUMBER: Final = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w)")  # not a part of a name, such as 16UC1
_KINDS: Final = 100  # of reasons that are counted


@dataclass
class View:
    """State of the graph at one moment."""

    sensor: Sensor = BIOTAC_SP  # whose readings are predicted
    answers: Counter[str] = field(default_factory=Counter)  # number of arrays of predictions by status
    reasons: Counter[str] = field(default_factory=Counter)  # how often each kind of reason was given; # is a number
    last_reasons: dict[str, str] = field(default_factory=dict)  # the last one of each kind
    last: TouchPredictionArray | None = None  # the last array
    executed: tuple[TouchPrediction, Sample] | None = None  # of the last grasp with success, and its readings
    # Last level, line and numbers by node name.
    nodes: dict[str, tuple[int, str, dict[str, str]]] = field(default_factory=dict)

    def count_reason(self, reason: str) -> None:
        """Count the kind of a reason, which is its text without its numbers."""
        kind = _NUMBER.sub("#", reason)
        if kind not in self.reasons and len(self.reasons) >= _KINDS:
            kind = "other"
        self.reasons[kind] += 1
        self.last_reasons[kind] = reason


Drawable: TypeAlias = tuple[Cloud | None, Object, TouchPrediction, Sample | None]
"""The whole cloud, if it was received; the object; its prediction; and the readings of the grasp, if it was executed."""


def _is_unfamiliar(prediction: TouchPrediction) -> bool:
    return "unfamiliar" in prediction.flags


def _coloured(cloud: Cloud, colours: Image | None) -> Cloud:
    """Return a cloud with the colours of its pixels; a `CloudError` if they are of another image."""
    if colours is None or not cloud.organised:
        return cloud
    rgb = colours_of(colours, cloud.frame_id, cloud.xyz.shape[:2])
    return Cloud(cloud.xyz, rgb, cloud.frame_id, cloud.stamp_ns)


class MonitorNode(Node):
    """Subscribes to `touch` and /diagnostics; also to the clouds, to draw an answer, and to the hand, to show its readings.

    Args:
        namespace: Of the graph.
        with_clouds: Whether clouds and colour images are kept, to draw an answer.
        hand: How the messages of the hand are read; None reads none.
        on_touch: Called with each message of `touch`, in the executor's thread; must return at once.
        sensor: For which touch is predicted.
        count: Messages of `touch` after which the view is closed; None for no limit.
        options: For rclpy's `Node`.
    """

    def __init__(
        self,
        *,
        namespace: str = NAMESPACE,
        with_clouds: bool = False,
        hand: TactileConfig | None = None,
        on_touch: Callable[[Any], None] | None = None,
        sensor: Sensor = BIOTAC_SP,
        count: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__("monitor", namespace=namespace, **options)
        self.internal_errors = InternalErrors(self.get_logger().error)
        self._lock = threading.Lock()
        self._view = View(sensor)
        self._on_touch, self._count = on_touch, count
        self._closed = False
        kept = 8 if hand is None else 32  # enough to find the cloud of an answer, or of an executed grasp
        self._scenes: deque[PointCloud2] = deque(maxlen=kept)
        self._objects: deque[PointCloud2] = deque(maxlen=kept)
        self._colours: deque[Image] = deque(maxlen=kept)
        self._drawable: deque[TouchPredictionArray] = deque(maxlen=kept)
        # The last by whether the model does not know the object, and whether it was touched before.
        self._executed: dict[tuple[bool, bool], Drawable] = {}
        self._assembler = SampleAssembler(AssemblerConfig(successes_only=True), make_reader(hand or TactileConfig()))
        self._with_hand = hand is not None
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(TouchPredictionArray, "touch", self._receive_touch, reliable)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._receive_diagnostics, 50)
        if hand is not None:
            kind = message_class(hand.message_type)
            self.create_subscription(kind, TACTILE_TOPIC, partial(self._assemble, "tactile"), reliable)
            self.create_subscription(ExecutedGrasp, EXECUTED_TOPIC, partial(self._assemble, "executed"), reliable)
            self.create_subscription(PointCloud2, CLOUD_TOPIC, self._receive_cloud, qos_profile_sensor_data, raw=True)
        if with_clouds:
            for topic, clouds in (("points", self._scenes), (CLOUD_TOPIC, self._objects)):
                self.create_subscription(PointCloud2, topic, partial(self._keep, clouds), qos_profile_sensor_data)
            self.create_subscription(Image, COLOUR_TOPIC, partial(self._keep, self._colours), qos_profile_sensor_data)

    def view(self) -> View:
        """Copy the state."""
        with self._lock:
            view = self._view
            copied = {name: copy(getattr(view, name)) for name in ("answers", "reasons", "last_reasons", "nodes")}
            return replace(view, **copied)

    def close_view(self) -> View:
        """End the view, and copy its state: later answers are neither counted nor passed on."""
        with self._lock:
            self._closed = True
        return self.view()

    def last_drawables(self) -> list[Drawable]:
        """Find the last predictions on an object that the model knows, and on one that it does not, as far as there are such.

        Of executed grasps they are the last that was predicted after a touch of its object, else the last one. If none was executed,
        they are the newest whose clouds are still kept.
        """
        with self._lock:
            executed = dict(self._executed)
            answers = [] if executed else list(self._drawable)
        if executed:  # one that was predicted after a touch comes after one before
            last = {unfamiliar: executed[unfamiliar, touched] for unfamiliar, touched in sorted(executed)}
            return list(last.values())
        newest: dict[bool, Drawable] = {}
        for answer in reversed(answers):
            prediction = answer.predictions[0]
            unfamiliar = _is_unfamiliar(prediction)
            if unfamiliar not in newest and (drawn := self._drawn(prediction)) is not None:
                newest[unfamiliar] = drawn
        return [newest[key] for key in sorted(newest)]

    def _drawn(self, prediction: TouchPrediction, readings: Sample | None = None) -> Drawable | None:
        """Find the clouds of a prediction; None if they are no longer kept, or in another frame than the prediction."""
        stamp = stamp_ns(prediction.header.stamp)
        with self._lock:
            scene_message, object_message, colours = (
                next((kept for kept in reversed(messages) if stamp_ns(kept.header.stamp) == stamp), None)
                for messages in (self._scenes, self._objects, self._colours)
            )
        if object_message is None or object_message.header.frame_id != prediction.header.frame_id:
            return None
        try:
            objects = decode_objects(object_message)
            scene = None if scene_message is None else _coloured(decode_cloud(scene_message), colours)
        except CloudError:
            return None
        for target in objects:
            if target.id == prediction.grasp.object_id:
                return scene, target, prediction, readings
        return None

    def _receive_touch(self, message: TouchPredictionArray) -> None:
        with self._lock:
            if self._closed:
                return
            self._view.answers[status_name(message.status)] += 1
            self._closed = self._view.answers.total() == self._count
            if message.reason:
                self._view.count_reason(message.reason)
            self._view.last = message
            if message.predictions:
                self._drawable.append(message)
                if self._with_hand:
                    self._assembler.matcher.add_plan(
                        stamp_ns(message.header.stamp),
                        message.header.frame_id,
                        [prediction.grasp for prediction in message.predictions],
                    )
            if self._on_touch is not None:
                self._on_touch(message)

    def _receive_cloud(self, data: bytes) -> None:
        try:
            seen = SeenObjects.of_message(data, lambda: decode_objects(read_serialized(data, PointCloud2)))
        except DatasetError:
            return  # the node that uses the message counts it
        self._assemble("cloud", seen)

    def _assemble(self, role: Role, message: Any) -> None:
        now_s = time.monotonic()
        with self._lock:
            try:
                self._assembler.add(role, message, received_ns=self.get_clock().now().nanoseconds, now_s=now_s)
            except (TactileError, DatasetError):
                return  # the node that uses the message counts it
            results = self._assembler.poll(now_s) if self._assembler.matcher.pending else []
            predictions = [touch for answer in self._drawable for touch in answer.predictions] if results else []
        for result in results:
            if isinstance(result, Sample) and result.touch is not None:
                for touch in predictions:
                    if touch.grasp.id == result.grasp.id:
                        drawn = self._drawn(touch, result)
                        with self._lock:
                            self._view.executed = touch, result
                            if drawn is not None:
                                self._executed[_is_unfamiliar(touch), bool(touch.touches)] = drawn

    def _receive_diagnostics(self, message: DiagnosticArray) -> None:
        with self._lock:
            for status in message.status:
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                self._view.nodes[status.name] = level, status.message, {pair.key: pair.value for pair in status.values}

    def _keep(self, messages: deque[Any], message: PointCloud2 | Image) -> None:
        with self._lock:
            last = self._view.last if self._closed else None
            if last is None or stamp_ns(message.header.stamp) <= stamp_ns(last.header.stamp):
                messages.append(message)
