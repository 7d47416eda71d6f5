# SPDX-License-Identifier: Apache-2.0
"""`points` -> `objects`, `table`, `object_cloud`: what stands on the table, and which of it is meant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.lifecycle import LifecyclePublisher
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.segmentation.segment import SegmentationConfig, TargetConfig
from foretouch.config import setting
from foretouch.pipeline import Pipeline, PipelineConfig, SegmentedScene
from foretouch.ros.messages.clouds import object_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import plane_to_msg, stamp_ns
from foretouch.ros.messages.markers import object_markers
from foretouch.ros.messages.requests import read_cloud
from foretouch.ros.messages.status import RefusalError, status_code
from foretouch.ros.runtime.processing_node import ProcessingConfig, ProcessingNode
from foretouch.ros.runtime.warm_up import tabletop
from foretouch_msgs.msg import ObjectArray, Status, TablePlane

__all__ = ["SegmentationNode", "SegmentationNodeConfig"]


@dataclass(frozen=True, kw_only=True)
class SegmentationNodeConfig(ProcessingConfig):
    """Settings of the segmentation node."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    frames: tuple[str, ...] = setting((), "Frames that clouds may come in; any that has a name if empty")


class SegmentationNode(ProcessingNode[SegmentationNodeConfig]):
    """Sees the table and the objects (`Pipeline.see`)."""

    _objects: LifecyclePublisher[Any]
    _table: LifecyclePublisher[Any]
    _object_cloud: LifecyclePublisher[Any]
    _markers: LifecyclePublisher[Any]

    def __init__(self, **options: Any) -> None:
        super().__init__("segmentation", SegmentationNodeConfig, [(PointCloud2, "points")], **options)
        self._pipeline = _pipeline(self.config)

    def setup(self) -> None:
        """Outputs before inputs, so that no answer is lost."""
        self._objects = self.advertise(ObjectArray, "objects")
        self._table = self.advertise(TablePlane, "table")
        self._object_cloud = self.advertise(PointCloud2, "object_cloud")
        self._markers = self.advertise(MarkerArray, "markers")
        self._pipeline.see(tabletop())
        super().setup()

    def config_changed(self, config: SegmentationNodeConfig) -> None:
        """Use the new settings from the next cloud on."""
        self._pipeline = _pipeline(config)

    def answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        """Segment one cloud."""
        self._check_frame(header.frame_id)
        cloud = read_cloud(messages["points"])
        sight = self._pipeline.see(cloud)
        status = status_code(sight.status)
        self._publish(header, sight, cloud.xyz.shape, status)
        return status, sight.reason

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Nothing was seen."""
        self._objects.publish(ObjectArray(header=header, status=status, reason=reason))
        self._table.publish(TablePlane(header=header, plane=plane_to_msg(None), status=status, reason=reason))
        self._object_cloud.publish(objects_to_msg((), header.frame_id, stamp_ns(header.stamp)))

    def _publish(self, header: Header, sight: SegmentedScene, shape: tuple[int, ...], status: int) -> None:
        found = sight.segmentation
        plane = plane_to_msg(found.plane)
        # What the grasp node waits for goes first.
        self._table.publish(TablePlane(header=header, plane=plane, status=status, reason=sight.reason))
        self._object_cloud.publish(objects_to_msg(sight.targets, header.frame_id, stamp_ns(header.stamp)))
        chosen = {target.id for target in sight.targets}
        objects = ObjectArray(
            header=header,
            height=shape[0] if len(shape) == 3 else 1,
            width=shape[-2],
            objects=[object_to_msg(one, target=str(one.id) in chosen) for one in found.objects],
            status=status,
            reason=sight.reason,
        )
        self._objects.publish(objects)
        if self._markers.get_subscription_count():
            self._markers.publish(object_markers(objects))

    def _check_frame(self, frame_id: str) -> None:
        allowed = self.config.frames
        if not frame_id:
            raise RefusalError(Status.UNKNOWN_FRAME, "header.frame_id: is empty, so nobody could place the answer")
        if allowed and frame_id not in allowed:
            raise RefusalError(Status.UNKNOWN_FRAME, f"header.frame_id: {frame_id!r} is none of {', '.join(allowed)}")


def _pipeline(config: SegmentationNodeConfig) -> Pipeline:
    return Pipeline(PipelineConfig(segmentation=config.segmentation, target=config.target))
