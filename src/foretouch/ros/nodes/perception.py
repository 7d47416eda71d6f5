# SPDX-License-Identifier: Apache-2.0
"""The node `perception`: a depth image or a cloud in; `objects`, `table`, `object_cloud`, `grasps` and `touch` out.

The answer to a cloud is four steps: message to arrays, the pipeline, arrays to messages, publish. The nodes `segmentation`, `grasp`
and `touch_predictor` run one step each, for who replaces another step by a node of another package.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from sensor_msgs.msg import PointCloud2

from foretouch.config import setting
from foretouch.ros.messages.placement import Placement
from foretouch.ros.messages.requests import (
    RefusalError,
    RequestedGrasps,
    Targets,
    check_frames,
    passed_on,
    read_objects,
    read_table,
    read_targets,
    status_code,
)
from foretouch.ros.runtime.matching_node import MatchingConfig, MatchingNode
from foretouch.ros.runtime.processing_node import Answer, Input, ProcessingConfig, ProcessingNode, Published, Step
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.steps.camera_input import CameraInput, CameraInputSettings
from foretouch.ros.steps.frames import Frames
from foretouch.ros.steps.grasping import GraspSettings, GraspStep, stream_config
from foretouch.ros.steps.segmentation import SegmentationSettings, SegmentationStep
from foretouch.ros.steps.services import TouchServices
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.stream import Stream
from foretouch.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch.types import ASSUMED_TABLE, stamp_ns
from foretouch.types.scene import Object
from foretouch_msgs.msg import GraspArray, Status, TablePlane

_OBJECTS: Final = InputTopic(CLOUD_TOPIC, PointCloud2), InputTopic("table", TablePlane)
_TABLES: Final = 16  # that are kept: one has the stamp of the latest object_cloud


@dataclass(frozen=True, kw_only=True)
class PerceptionConfig(MatchingConfig, CameraInputSettings, SegmentationSettings, GraspSettings, TouchSettings):
    """Settings of all steps."""

    input: str = setting(
        "depth",
        "What is received: depth, the topics depth/image and depth/camera_info; points, the topic of clouds; objects, "
        "the topics object_cloud and table of who segments",
        choices=("depth", "points", "objects"),
        read_only=True,
    )


class PerceptionNode(MatchingNode[PerceptionConfig]):
    """Segments, plans and predicts."""

    default_name, config_class = "perception", PerceptionConfig
    inputs = _OBJECTS  # where `input` is objects
    exclusive_topics = ("objects", GRASPS_TOPIC, "touch")

    def _setup(self) -> None:
        self._frames, stream = Frames(self), Stream(stream_config(self.config))
        self._planner, self._touch = GraspStep(self, stream), TouchStep(self, self._frames)
        self.steps = (self._planner, self._touch, TouchServices(self, self._touch))
        if self.config.input == "objects":  # subscriptions come last, so that no answer is lost
            super()._setup()
        else:
            self._segmentation = SegmentationStep(self, stream)
            self._camera = CameraInput(
                self, self._receive, lambda: self._touch.uses_colours or self._segmentation.shows_colours
            )
            self.steps = (self._segmentation, *self.steps, self._camera)

    def _answer(self, item: Input) -> Answer:
        header, planner, touch = item.header, self._planner, self._touch
        targets, status, reason, of_scene = self._seen(item)
        touch.latest = targets if targets.objects else targets._replace(refusal=RefusalError(status, reason))
        if not targets.objects:
            refusals = [(step, partial(step.refuse, header, status, reason)) for step in (planner, touch)]
            return Answer(status, reason, [*of_scene, *refusals])
        grasps, plans = planner.plan(targets.objects, header, reason)
        first = next((plan.grasps[0] for plan in plans if len(plan.grasps)), None)
        publish: list[Published] = [(step, partial(call, grasp=first)) for step, call in of_scene]  # which show it
        publish.append((planner, partial(planner.publish, grasps, targets.answered_in)))
        if grasps.grasps:
            answer = touch.answer_plans(targets.objects, plans, grasps)
            status, reason = answer.summary
            publish.append((touch, partial(touch.publish, answer, grasps, targets)))
        else:
            status, reason = grasps.status, grasps.reason
            publish.append((touch, partial(touch.refuse, header, status, reason)))
        return Answer(status, reason, publish)

    def _seen(self, item: Input) -> tuple[Targets, int, str, list[tuple[Step, Callable[..., object]]]]:
        """Return the targets of an input, status and reason where there are none, and what is published of the scene."""
        header = item.header
        if self.config.input == "objects":
            objects, table = item.content[CLOUD_TOPIC], item.content["table"]
            placement = self._frames.placement(header)
            found = read_objects(objects, table, self.config.limits)
            return Targets(header, found, placement=placement), table.status, table.reason, []
        cloud = self._camera.cloud(item.content)
        placement = self._frames.placement(header)
        scene = self._segmentation.segment(cloud)
        publish = partial(self._segmentation.publish, header, scene, placement)
        targets = Targets(header, scene.targets, placement=placement)
        return targets, status_code(scene.status), scene.reason, [(self._segmentation, publish)]


@dataclass(frozen=True, kw_only=True)
class SegmentationNodeConfig(ProcessingConfig, CameraInputSettings, SegmentationSettings):
    """Settings of the segmentation node."""


class SegmentationNode(ProcessingNode[SegmentationNodeConfig]):
    """Runs the step of the segmentation."""

    default_name, config_class = "segmentation", SegmentationNodeConfig
    exclusive_topics = ("objects",)

    def _setup(self) -> None:
        self._frames, stream = Frames(self), Stream(stream_config(self.config))
        self._step = SegmentationStep(self, stream)  # before subscribing, so that no answer is lost
        self._camera = CameraInput(self, self._receive, lambda: self._step.shows_colours)
        self.steps = (self._step, self._camera)

    def _answer(self, item: Input) -> Answer:
        cloud = self._camera.cloud(item.content)
        placement = self._frames.placement(item.header)
        scene = self._step.segment(cloud)
        publish = [(self._step, partial(self._step.publish, item.header, scene, placement))]
        return Answer(status_code(scene.status), scene.reason, publish)


@dataclass(frozen=True, kw_only=True)
class GraspNodeConfig(MatchingConfig, GraspSettings):
    """Settings of the grasp node."""


class GraspNode(MatchingNode[GraspNodeConfig]):
    """Runs the step of the planner."""

    default_name, config_class = "grasp", GraspNodeConfig
    inputs = _OBJECTS
    exclusive_topics = (GRASPS_TOPIC,)

    def _setup(self) -> None:
        self._frames, stream = Frames(self), Stream(stream_config(self.config))
        self._step = GraspStep(self, stream)  # before subscribing, so that no answer is lost
        self.steps = (self._step,)
        super()._setup()

    def _answer(self, item: Input) -> Answer:
        table = item.content["table"]
        targets = read_objects(item.content[CLOUD_TOPIC], table, self.config.limits)
        placement = self._frames.placement(item.header)
        message, _ = self._step.plan(targets, item.header, table.reason)
        return Answer(message.status, message.reason, [(self._step, partial(self._step.publish, message, placement))])


@dataclass(frozen=True, kw_only=True)
class TouchPredictorConfig(MatchingConfig, TouchSettings):
    """Settings of the touch predictor."""


class TouchPredictorNode(MatchingNode[TouchPredictorConfig]):
    """Runs the step of the touch model."""

    default_name, config_class = "touch_predictor", TouchPredictorConfig
    inputs = InputTopic(CLOUD_TOPIC, PointCloud2), InputTopic(GRASPS_TOPIC, GraspArray)
    exclusive_topics = ("touch",)

    def _setup(self) -> None:
        self._tables: dict[int, TablePlane] = {}  # by stamp [ns]
        self._frames = Frames(self)
        self._step = TouchStep(self, self._frames)  # before subscribing, so that no answer is lost
        self.steps = (self._step, TouchServices(self, self._step))
        self.subscribe(InputTopic("table", TablePlane), self._remember_table)
        super()._setup()

    def _answer(self, item: Input) -> Answer:
        grasps, targets = item.content[GRASPS_TOPIC], self._read(item.content[CLOUD_TOPIC])
        if not grasps.grasps:
            raise passed_on(GRASPS_TOPIC, grasps.status or Status.NO_GRASP, grasps.reason or "grasps: is empty")
        check_frames(GRASPS_TOPIC, grasps.header, item.header)
        if targets.refusal is not None:
            raise targets.refusal
        answer = self._step.answer(targets, RequestedGrasps.of_messages(grasps.grasps))
        return Answer(*answer.summary, [(self._step, partial(self._step.publish, answer, grasps, targets))])

    def _remember_table(self, message: TablePlane) -> None:
        self._tables[stamp_ns(message.header.stamp)] = message
        while len(self._tables) > _TABLES:
            del self._tables[next(iter(self._tables))]

    def _read(self, cloud: PointCloud2) -> Targets:
        """Read the objects of a cloud, and remember them for requests if their table is known."""
        table, limits = self._tables.get(stamp_ns(cloud.header.stamp)), self.config.limits
        objects: tuple[Object, ...] = ()
        placement: Placement | None = None
        refusal: RefusalError | None = None
        try:
            placement = self._frames.placement(cloud.header)
            objects = read_targets(cloud, ASSUMED_TABLE, limits)  # as if the camera looked straight down
            if table is not None:
                plane, obstacles = read_table(table, cloud.header)
                objects = tuple(replace(target, plane=plane, obstacles=obstacles) for target in objects)
        except RefusalError as err:
            refusal = err
        targets = Targets(cloud.header, objects, refusal, placement)
        if table is not None:
            self._step.latest = targets
        return targets
