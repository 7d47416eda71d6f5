# SPDX-License-Identifier: Apache-2.0
"""Nodes that run one step of `perception` each, for who replaces another step by a node of another package.

The segmentation turns what the camera sends into `objects`, `table` and `object_cloud`, the planner these into `grasps`, and the
touch predictor these into `touch`, with its services and actions.
"""

from dataclasses import dataclass

from sensor_msgs.msg import PointCloud2

from foretouch.pipeline import Object
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
from foretouch.ros.runtime.processing_node import Input, ProcessingConfig, ProcessingNode
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.steps.camera_input import CameraInput, CameraInputSettings
from foretouch.ros.steps.grasping import GraspSettings, GraspStep
from foretouch.ros.steps.segmentation import SegmentationSettings, SegmentationStep
from foretouch.ros.steps.services import TouchServices
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch.types import ASSUMED_TABLE, stamp_ns
from foretouch_msgs.msg import GraspArray, Status, TablePlane

_TABLES = 16  # one has the stamp of the latest object_cloud


@dataclass(frozen=True, kw_only=True)
class SegmentationNodeConfig(ProcessingConfig, CameraInputSettings, SegmentationSettings):
    """Settings of the segmentation node."""


class SegmentationNode(ProcessingNode[SegmentationNodeConfig]):
    """Runs the step of the segmentation."""

    default_name, config_class = "segmentation", SegmentationNodeConfig
    exclusive_topics = ("objects",)

    def _setup(self) -> None:
        self._step = SegmentationStep(self)  # before subscribing, so that no answer is lost
        self._camera = CameraInput(self, self._receive)
        self.steps = (self._step, self._camera)

    def _answer(self, item: Input) -> tuple[int, str]:
        cloud = self._camera.cloud(item.content)
        scene = self._step.segment(cloud)
        self._step.publish(item.header, scene)
        return status_code(scene.status), scene.reason


@dataclass(frozen=True, kw_only=True)
class GraspNodeConfig(MatchingConfig, GraspSettings):
    """Settings of the grasp node."""


class GraspNode(MatchingNode[GraspNodeConfig]):
    """Runs the step of the planner."""

    default_name, config_class = "grasp", GraspNodeConfig
    inputs = InputTopic(CLOUD_TOPIC, PointCloud2), InputTopic("table", TablePlane)
    exclusive_topics = (GRASPS_TOPIC,)

    def _setup(self) -> None:
        self._step = GraspStep(self)  # before subscribing, so that no answer is lost
        self.steps = (self._step,)
        super()._setup()

    def _answer(self, item: Input) -> tuple[int, str]:
        table = item.content["table"]
        targets = read_objects(item.content[CLOUD_TOPIC], table, self.config.limits)
        message, _ = self._step.plan(targets, item.header, table.reason)
        self._step.publish(message)
        return message.status, message.reason


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
        self._step = TouchStep(self)  # before subscribing, so that no answer is lost
        self.steps = (self._step, TouchServices(self, self._step))
        self.subscribe(InputTopic("table", TablePlane), self._remember_table)
        super()._setup()

    def _answer(self, item: Input) -> tuple[int, str]:
        cloud, grasps = item.content[CLOUD_TOPIC], item.content[GRASPS_TOPIC]
        self._remember_objects(cloud)
        if not grasps.grasps:
            raise passed_on(GRASPS_TOPIC, grasps.status or Status.NO_GRASP, grasps.reason or "grasps: is empty")
        check_frames(GRASPS_TOPIC, grasps.header, item.header)
        table = self._tables.get(stamp_ns(cloud.header.stamp))  # without one, the camera is taken to look straight down
        plane = read_table(table, item.header) if table else ASSUMED_TABLE
        targets = Targets(item.header, read_targets(cloud, plane, self.config.limits), lambda: cloud)
        answer = self._step.answer(targets, RequestedGrasps.of_messages(grasps.grasps))
        self._step.publish(answer, grasps, targets)
        return answer.summary

    def _remember_table(self, message: TablePlane) -> None:
        self._tables[stamp_ns(message.header.stamp)] = message
        while len(self._tables) > _TABLES:
            del self._tables[next(iter(self._tables))]

    def _remember_objects(self, cloud: PointCloud2) -> None:
        """Remember objects and table for requests, if both are there."""
        if (table := self._tables.get(stamp_ns(cloud.header.stamp))) is None:
            return
        targets: tuple[Object, ...] = ()
        refusal: RefusalError | None = None
        try:
            targets = read_targets(cloud, ASSUMED_TABLE, self.config.limits)
            targets = read_objects(cloud, table, self.config.limits)
        except RefusalError as err:
            refusal = err
        self._step.latest = Targets(cloud.header, targets, lambda: cloud, refusal)
