# SPDX-License-Identifier: Apache-2.0
"""The whole road in one node: a depth image or a cloud in, `objects`, `table`, `object_cloud`, `grasps` and `touch` out.

The answer to a cloud is four steps: message to arrays, the pipeline, arrays to messages, publish.
"""

from dataclasses import dataclass
from functools import partial

from sensor_msgs.msg import PointCloud2

from foretouch.config import setting
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.requests import RefusalError, Targets, read_objects, status_code
from foretouch.ros.runtime.matching_node import MatchingConfig, MatchingNode
from foretouch.ros.runtime.processing_node import Input
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.steps.camera_input import CameraInput, CameraInputSettings
from foretouch.ros.steps.grasping import GraspSettings, GraspStep
from foretouch.ros.steps.segmentation import SegmentationSettings, SegmentationStep
from foretouch.ros.steps.services import TouchServices
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch.types import stamp_ns
from foretouch_msgs.msg import TablePlane


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
    inputs = InputTopic(CLOUD_TOPIC, PointCloud2), InputTopic("table", TablePlane)  # where `input` is objects
    exclusive_topics = ("objects", GRASPS_TOPIC, "touch")

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
            targets = Targets(header, read_objects(objects, table, self.config.limits), lambda: objects)
            return self._answer_targets(targets, table.status, table.reason)
        cloud = self._camera.cloud(item.content)
        scene = self._segmentation.segment(cloud)
        message = partial(objects_to_msg, scene.targets, header.frame_id, stamp_ns(header.stamp))
        outcome = self._answer_targets(Targets(header, scene.targets, message), status_code(scene.status), scene.reason)
        self._segmentation.publish(header, scene)
        return outcome

    def _answer_targets(self, targets: Targets, status: int, reason: str) -> tuple[int, str]:
        """Plan and predict on targets; without any, status and reason say why."""
        header = targets.header
        if not targets.objects:
            self._touch.latest = targets._replace(refusal=RefusalError(status, reason))
            for step in (self._touch, self._planner):
                step.refuse(header, status, reason)
            return status, reason
        self._touch.latest = targets
        grasps, plans = self._planner.plan(targets.objects, header, reason)
        if grasps.grasps:
            answer = self._touch.answer_plans(targets.objects, plans, grasps)
            self._touch.publish(answer, grasps, targets)
            status, reason = answer.summary
        else:
            status, reason = grasps.status, grasps.reason
            self._touch.refuse(header, status, reason)
        self._planner.publish(grasps)
        return status, reason
