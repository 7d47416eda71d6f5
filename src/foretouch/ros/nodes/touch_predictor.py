# SPDX-License-Identifier: Apache-2.0
"""`object_cloud` + `grasps` -> `touch` with services and actions alone, for who segments or plans with nodes of another package."""

from dataclasses import dataclass
from typing import Any

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
)
from foretouch.ros.runtime.matching_node import MatchingConfig, MatchingNode
from foretouch.ros.runtime.processing_node import Input
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.steps.services import TouchServices
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.topics import CLOUD_TOPIC, GRASPS_TOPIC
from foretouch.types import ASSUMED_TABLE, stamp_ns
from foretouch_msgs.msg import GraspArray, Status, TablePlane

_TABLES = 16  # one has the stamp of the latest object_cloud


@dataclass(frozen=True, kw_only=True)
class TouchPredictorConfig(MatchingConfig, TouchSettings):
    """Settings of the touch predictor."""


class TouchPredictorNode(MatchingNode[TouchPredictorConfig]):
    """Runs the step of the touch model."""

    exclusive_topics = ("touch",)

    def __init__(self, **options: Any) -> None:
        inputs = [(PointCloud2, CLOUD_TOPIC), (GraspArray, GRASPS_TOPIC)]
        super().__init__("touch_predictor", TouchPredictorConfig, inputs, **options)
        self._tables: dict[int, TablePlane] = {}  # by stamp [ns]

    def _setup(self) -> None:
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
        targets = read_targets(cloud, plane, self.config.limits)
        answer = self._step.answer(targets, RequestedGrasps.of_messages(grasps.grasps), item.header)
        self._step.publish(answer, grasps, lambda: cloud)
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
