# SPDX-License-Identifier: Apache-2.0
"""The whole road in one node: a depth image or a cloud in, `objects`, `table`, `object_cloud`, `grasps` and `touch` out.

The answer to a cloud is four steps: message to arrays, the pipeline, arrays to messages, publish.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from sensor_msgs.msg import PointCloud2

from foretouch.config import setting
from foretouch.grasp import GraspPlan
from foretouch.pipeline import Object
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.requests import RefusalError, Targets, read_objects, status_code
from foretouch.ros.runtime.matching_node import MatchingConfig, MatchingNode
from foretouch.ros.runtime.processing_node import Input
from foretouch.ros.steps.camera_input import CameraInput, CameraInputSettings
from foretouch.ros.steps.grasping import GraspSettings, GraspStep
from foretouch.ros.steps.segmentation import SegmentationSettings, SegmentationStep
from foretouch.ros.steps.services import TouchServices
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch.types import stamp_ns
from foretouch_msgs.msg import GraspArray, TablePlane


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

    exclusive_topics = ("objects", GRASPS_TOPIC, "touch")

    def __init__(self, **options: Any) -> None:
        super().__init__("perception", PerceptionConfig, [(PointCloud2, CLOUD_TOPIC), (TablePlane, "table")], **options)

    def _setup(self) -> None:
        self._planner, self._touch = GraspStep(self), TouchStep(self)
        self.steps = (self._planner, self._touch, TouchServices(self, self._touch))
        if self.config.input == "objects":  # subscriptions come last, so that no answer is lost
            super()._setup()
        else:
            self._segmentation = SegmentationStep(self)
            self._camera = CameraInput(self, self._receive)
            self.steps = (self._segmentation, *self.steps, self._camera)

    def _answer(self, item: Input) -> tuple[int, str]:
        header = item.header
        if self.config.input == "objects":
            objects, table = item.content[CLOUD_TOPIC], item.content["table"]
            targets = read_objects(objects, table, self.config.limits)
            return self._answer_targets(item, targets, lambda: objects, table.status, table.reason)
        cloud = self._camera.cloud(item.content)
        scene = self._segmentation.segment(cloud)
        message = partial(objects_to_msg, scene.targets, header.frame_id, stamp_ns(header.stamp))
        outcome = self._answer_targets(item, scene.targets, message, status_code(scene.status), scene.reason)
        self._segmentation.publish(header, scene, cloud.xyz.shape)
        return outcome

    def _answer_targets(
        self, item: Input, targets: Sequence[Object], message: Callable[[], PointCloud2], status: int, reason: str
    ) -> tuple[int, str]:
        """Plan and predict on targets, none with the status and reason; `message` makes their `object_cloud`."""
        header = item.header
        self._touch.latest = Targets(header, tuple(targets), message, None if targets else RefusalError(status, reason))
        grasps = GraspArray(header=header, status=status, reason=reason)
        plans: Sequence[GraspPlan] = ()
        if targets:
            grasps, plans = self._planner.plan(targets, header, reason)
        if grasps.grasps:
            answer = self._touch.answer_plans(targets, plans, grasps)
            self._touch.publish(answer, grasps, message)
            status, reason = answer.summary
        else:
            status, reason = grasps.status, grasps.reason
            self._touch.refuse(header, status, reason)
        self._planner.publish(grasps)
        return status, reason
