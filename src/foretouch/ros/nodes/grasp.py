# SPDX-License-Identifier: Apache-2.0
"""`object_cloud` + `table` -> `grasps`: where two fingers can grasp each target."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.config import setting
from foretouch.dataset.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch.grasp import GeoGraspConfig, GraspHold, HandConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.requests import plan_targets, read_obstacles, read_table, read_targets
from foretouch.ros.runtime.processing_node import ProcessingConfig, ProcessingNode, warm_up_cloud
from foretouch_msgs.msg import GraspArray, TablePlane

HOLD_TOLERANCE_M: Final = 0.005
"""Change of position or size that makes it another object, whose grasp is not kept."""


@dataclass(frozen=True, kw_only=True)
class GraspNodeConfig(ProcessingConfig):
    """Settings of the grasp node."""

    limits: ObjectLimits = ObjectLimits()
    grasp: GeoGraspConfig = GeoGraspConfig()
    hand: HandConfig = HandConfig()
    grasp_hold: float = setting(
        0.5,
        "The last grasp of an object is kept until another is better by this score on three clouds in a row; "
        "0 disables it, as grasp.method original",
        bounds=(0.0, 1000.0),
    )


class GraspNode(ProcessingNode[GraspNodeConfig]):
    """Plans grasps on each target (`Pipeline.plan`)."""

    exclusive_topics = (GRASPS_TOPIC,)

    def __init__(self, **options: Any) -> None:
        super().__init__("grasp", GraspNodeConfig, [(PointCloud2, CLOUD_TOPIC), (TablePlane, "table")], **options)
        self._config_changed(self.config)

    def _setup(self) -> None:
        self._grasps = self.advertise(GraspArray, GRASPS_TOPIC, keep=True)  # before subscribing: no answer is lost
        for target in self._pipeline.segment(warm_up_cloud()).targets:
            self._pipeline.plan(target)
        super()._setup()

    def _config_changed(self, config: GraspNodeConfig) -> None:
        self._pipeline = Pipeline(PipelineConfig(grasp=config.grasp, hand=config.hand, limits=config.limits))
        holds = config.grasp_hold > 0.0 and config.grasp.method == "completed"
        self._held = GraspHold(HOLD_TOLERANCE_M) if holds else None

    def _answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        table = messages["table"]
        targets = read_targets(messages[CLOUD_TOPIC], read_table(table, header), self.config.limits)
        obstacles = read_obstacles(table)
        targets = tuple(replace(one, obstacles=obstacles) for one in targets)
        message = plan_targets(self._pipeline, targets, header, table.reason, self._held, self.config.grasp_hold)
        for grasp in message.grasps:  # as after serialisation, for subscribers of this process
            grasp.score = float(np.float32(grasp.score))
        self._grasps.publish(message)
        return message.status, message.reason

    def _refuse(self, header: Header, status: int, reason: str) -> None:
        self._grasps.publish(GraspArray(header=header, status=status, reason=reason))
