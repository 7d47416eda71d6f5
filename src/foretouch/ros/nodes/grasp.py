# SPDX-License-Identifier: Apache-2.0
"""`object_cloud` + `table` -> `grasps` alone, for who segments or predicts with a node of another package."""

from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import PointCloud2

from foretouch.ros.messages.requests import read_objects
from foretouch.ros.runtime.matching_node import MatchingConfig, MatchingNode
from foretouch.ros.runtime.processing_node import Input
from foretouch.ros.steps.grasping import GraspSettings, GraspStep
from foretouch.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch_msgs.msg import TablePlane


@dataclass(frozen=True, kw_only=True)
class GraspNodeConfig(MatchingConfig, GraspSettings):
    """Settings of the grasp node."""


class GraspNode(MatchingNode[GraspNodeConfig]):
    """Runs the step of the planner."""

    exclusive_topics = (GRASPS_TOPIC,)

    def __init__(self, **options: Any) -> None:
        super().__init__("grasp", GraspNodeConfig, [(PointCloud2, CLOUD_TOPIC), (TablePlane, "table")], **options)

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
