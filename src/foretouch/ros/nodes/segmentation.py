# SPDX-License-Identifier: Apache-2.0
"""`points` -> `objects`, `table`, `object_cloud`: the objects on the table, and which of them to grasp."""

from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.segmentation.objects import TargetConfig
from foretouch.cloud.segmentation.segment import SegmentationConfig
from foretouch.config import setting
from foretouch.pipeline import Pipeline, PipelineConfig, SegmentedScene
from foretouch.ros.messages.clouds import TargetCloud, object_to_msg
from foretouch.ros.messages.conversions import plane_to_msg
from foretouch.ros.messages.markers import object_markers
from foretouch.ros.messages.requests import RefusalError, read_cloud, status_code
from foretouch.ros.runtime.direct import DirectPublisher
from foretouch.ros.runtime.processing_node import ProcessingConfig, ProcessingNode, warm_up_cloud
from foretouch.topics import CLOUD_TOPIC
from foretouch.types import Float64
from foretouch_msgs.msg import ObjectArray, Status, TablePlane


@dataclass(frozen=True, kw_only=True)
class SegmentationNodeConfig(ProcessingConfig):
    """Settings of the segmentation node."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    frames: tuple[str, ...] = setting((), "Accepted frames of the clouds; if empty, every frame that has a name")


class SegmentationNode(ProcessingNode[SegmentationNodeConfig]):
    """Finds the table and the objects (`Pipeline.segment`)."""

    _objects: DirectPublisher
    _table: DirectPublisher
    _object_cloud: DirectPublisher
    _markers: DirectPublisher

    def __init__(self, **options: Any) -> None:
        super().__init__("segmentation", SegmentationNodeConfig, [(PointCloud2, "points")], **options)
        self._pipeline = _pipeline(self.config)
        self._previous: Float64 | None = None  # (3,) centroid of the last single target [m]

    def setup(self) -> None:
        """Advertise before subscribing, so that no answer is lost."""
        self._objects = self.advertise(ObjectArray, "objects")
        self._table = self.advertise(TablePlane, "table")
        self._object_cloud = self.advertise(PointCloud2, CLOUD_TOPIC)
        self._markers = self.advertise(MarkerArray, "markers")
        self._pipeline.segment(warm_up_cloud())
        super().setup()

    def config_changed(self, config: SegmentationNodeConfig) -> None:
        """Apply the new settings from the next cloud on."""
        self._pipeline = _pipeline(config)
        self._previous = None

    def exclusive_topics(self) -> tuple[str, ...]:
        """The answers of this node."""
        return ("objects",)

    def answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        """Segment one cloud."""
        self._check_frame(header.frame_id)
        cloud = read_cloud(messages["points"])
        scene = self._pipeline.segment(cloud, self._previous)
        ids = [target.id for target in scene.targets]
        centroids = [one.centroid for one in scene.segmentation.objects if [str(one.id)] == ids]
        self._previous = centroids[0] if centroids else None
        status = status_code(scene.status)
        self._publish(header, scene, cloud.xyz.shape, status)
        return status, scene.reason

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish that nothing was found."""
        self._objects.publish(ObjectArray(header=header, status=status, reason=reason))
        self._table.publish(TablePlane(header=header, plane=plane_to_msg(None), status=status, reason=reason))
        self._object_cloud.publish(TargetCloud(header, ()))

    def _publish(self, header: Header, scene: SegmentedScene, shape: tuple[int, ...], status: int) -> None:
        plane = plane_to_msg(scene.segmentation.plane)
        # First what the grasp node waits for.
        self._table.publish(TablePlane(header=header, plane=plane, status=status, reason=scene.reason))
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
        )
        self._objects.publish(objects)
        if self._markers.wanted:
            self.internal_errors.guarded("markers", self._draw)(objects)  # the answer is published

    def _draw(self, objects: ObjectArray) -> None:
        self._markers.publish(object_markers(objects))

    def _check_frame(self, frame_id: str) -> None:
        allowed = self.config.frames
        if not frame_id:
            raise RefusalError(Status.UNKNOWN_FRAME, "header.frame_id: is empty, so the answer would have no frame")
        if allowed and frame_id not in allowed:
            raise RefusalError(Status.UNKNOWN_FRAME, f"header.frame_id: {frame_id!r} is none of {', '.join(allowed)}")


def _pipeline(config: SegmentationNodeConfig) -> Pipeline:
    return Pipeline(PipelineConfig(segmentation=config.segmentation, target=config.target))
