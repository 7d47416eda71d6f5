# SPDX-License-Identifier: Apache-2.0
"""`points` -> `objects`, `table`, `object_cloud`: the objects on the table, and which of them to grasp."""

import array
from dataclasses import dataclass
from typing import Any

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.segmentation.identity import ObjectIdentity
from foretouch.cloud.segmentation.objects import TargetConfig
from foretouch.cloud.segmentation.segment import SegmentationConfig
from foretouch.config import setting
from foretouch.dataset.topics import CLOUD_TOPIC
from foretouch.grasp import HandConfig
from foretouch.pipeline import Pipeline, PipelineConfig, SegmentedScene
from foretouch.ros.messages.clouds import TargetCloud, object_to_msg
from foretouch.ros.messages.conversions import obstacles_to_msg, plane_to_msg
from foretouch.ros.messages.markers import object_markers
from foretouch.ros.messages.requests import RefusalError, read_cloud, status_code
from foretouch.ros.runtime.processing_node import ProcessingConfig, ProcessingNode, warm_up_cloud
from foretouch.types import Float64
from foretouch_msgs.msg import ObjectArray, Status, TablePlane


@dataclass(frozen=True, kw_only=True)
class SegmentationNodeConfig(ProcessingConfig):
    """Settings of the segmentation node."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    hand: HandConfig = HandConfig()  # with which `target.mode` free plans grasps; as that of the grasp node
    frames: tuple[str, ...] = setting((), "Accepted frames of the clouds; if empty, every frame that has a name")


class SegmentationNode(ProcessingNode[SegmentationNodeConfig]):
    """Finds the table and the objects (`Pipeline.segment`)."""

    exclusive_topics = ("objects",)

    def __init__(self, **options: Any) -> None:
        super().__init__("segmentation", SegmentationNodeConfig, [(PointCloud2, "points")], **options)
        self._config_changed(self.config)

    def _setup(self) -> None:
        self._objects = self.advertise(ObjectArray, "objects")  # before subscribing, so that no answer is lost
        self._table = self.advertise(TablePlane, "table")
        self._object_cloud = self.advertise(PointCloud2, CLOUD_TOPIC)
        self._markers = self.advertise(MarkerArray, "markers")
        self._pipeline.segment(warm_up_cloud())
        super()._setup()

    def _config_changed(self, config: SegmentationNodeConfig) -> None:
        self._pipeline = Pipeline(
            PipelineConfig(segmentation=config.segmentation, target=config.target, hand=config.hand)
        )
        self._identity = ObjectIdentity()
        self._previous: Float64 | None = None  # (3,) centroid of the last single target [m]

    def _answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        frame, allowed = header.frame_id, self.config.frames
        if not frame:
            raise RefusalError(Status.UNKNOWN_FRAME, "header.frame_id: is empty, so the answer would have no frame")
        if allowed and frame not in allowed:
            raise RefusalError(Status.UNKNOWN_FRAME, f"header.frame_id: {frame!r} is not one of {', '.join(allowed)}")
        cloud = read_cloud(messages["points"])
        scene = self._pipeline.segment(cloud, self._previous, self._identity)
        ids = [target.id for target in scene.targets]
        centroids = [one.centroid for one in scene.segmentation.objects if [str(one.id)] == ids]
        self._previous = centroids[0] if centroids else None
        status = status_code(scene.status)
        self._publish(header, scene, cloud.xyz.shape, status)
        return status, scene.reason

    def _refuse(self, header: Header, status: int, reason: str) -> None:
        self._objects.publish(ObjectArray(header=header, status=status, reason=reason))
        self._table.publish(TablePlane(header=header, plane=plane_to_msg(None), status=status, reason=reason))
        self._object_cloud.publish(TargetCloud(header, ()))

    def _publish(self, header: Header, scene: SegmentedScene, shape: tuple[int, ...], status: int) -> None:
        table = TablePlane(
            header=header,
            plane=plane_to_msg(scene.segmentation.plane),
            **obstacles_to_msg(scene.obstacles),
            status=status,
            reason=scene.reason,
            outline=array.array("f", scene.segmentation.outline.astype(np.float32).tobytes()),
        )
        self._table.publish(table)  # first what the grasp node waits for
        self._object_cloud.publish(TargetCloud(header, scene.targets))
        if not (self._objects.wanted or self._markers.wanted):
            return
        chosen = {target.id for target in scene.targets}
        objects = ObjectArray(
            header=header,
            height=shape[0] if len(shape) == 3 else 1,
            width=shape[-2],
            objects=[object_to_msg(one, target=str(one.id) in chosen) for one in scene.segmentation.objects],
            status=status,
            reason=scene.reason,
            background=[one.background for one in scene.segmentation.background],
        )
        self._objects.publish(objects)
        if self._markers.wanted:  # the answer is published: an error must not refuse the cloud
            self.internal_errors.guarded("markers", lambda: self._markers.publish(object_markers(objects, table)))()
