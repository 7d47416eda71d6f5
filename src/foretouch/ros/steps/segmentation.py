# SPDX-License-Identifier: Apache-2.0
"""Cloud -> `objects`, `table`, `object_cloud`: the objects on the table, and which of them to grasp."""

import array
from dataclasses import dataclass
from typing import Any

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.cloud.segmentation.objects import TargetConfig
from foretouch.cloud.segmentation.segment import SegmentationConfig
from foretouch.errors import CloudError
from foretouch.grasp import GeoGraspConfig, HandConfig
from foretouch.ros.messages.clouds import object_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import obstacles_to_msg, plane_to_msg
from foretouch.ros.messages.markers import object_markers
from foretouch.ros.messages.requests import RefusalError, status_code
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step, warm_up_cloud
from foretouch.ros.steps.grasping import stream_config
from foretouch.ros.steps.selection import Selection, SelectionSettings
from foretouch.stream import Stream
from foretouch.topics import CLOUD_TOPIC
from foretouch.types import Cloud, stamp_ns
from foretouch.types.scene import Scene
from foretouch_msgs.msg import ObjectArray, Status, TablePlane


@dataclass(frozen=True, kw_only=True)
class SegmentationSettings(SelectionSettings):
    """Settings of the segmentation."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    limits: ObjectLimits = ObjectLimits()  # with which `target.mode` free plans grasps
    grasp: GeoGraspConfig = GeoGraspConfig()  # the same
    hand: HandConfig = HandConfig()  # the same


class SegmentationStep(Step):
    """Finds the table and the objects (`Stream.find`), and publishes them.

    Args:
        node: Publishes; it must be configuring, and its settings are `SegmentationSettings`.
        stream: Of the clouds.
    """

    def __init__(self, node: ForetouchNode[Any], stream: Stream) -> None:
        self._node, self._stream = node, stream
        self._objects = node.advertise(ObjectArray, "objects")
        self._table = node.advertise(TablePlane, "table")
        self._object_cloud = node.advertise(PointCloud2, CLOUD_TOPIC)
        self._markers = node.advertise(MarkerArray, "markers")
        self._selection = Selection(node, stream)
        stream.pipeline.segment(warm_up_cloud())

    def configure(self, config: SegmentationSettings) -> None:
        """Use other settings."""
        self._stream.configure(stream_config(config))

    def segment(self, cloud: Cloud) -> Scene:
        """Find the table and the objects; of equal ones, the target of the cloud before stays the target.

        Raises:
            RefusalError: If a mask is wanted, and none fits the cloud.
        """
        mask = self._selection.mask(cloud)
        try:
            scene = self._stream.find(cloud, mask=mask)
        except CloudError as err:
            raise RefusalError(Status.BAD_REQUEST, str(err)) from err
        self._selection.take_click(scene)
        return self._stream.with_target(scene)

    def publish(self, header: Header, scene: Scene) -> None:
        """Publish a scene for those who subscribe.

        Args:
            header: Of the cloud.
            scene: Found in it.
        """
        state: dict[str, Any] = {"header": header, "status": status_code(scene.status), "reason": scene.reason}
        drawn = self._markers.get_subscription_count()
        if self._table.get_subscription_count() or drawn:
            outline = array.array("f", scene.outline.astype(np.float32).tobytes())
            plane, obstacles = plane_to_msg(scene.table), obstacles_to_msg(scene.obstacles)
            table = TablePlane(plane=plane, outline=outline, **obstacles, **state)
            self._table.publish(table)
        if self._object_cloud.get_subscription_count():
            self._object_cloud.publish(objects_to_msg(scene.targets, header.frame_id, stamp_ns(header.stamp)))
        if not (self._objects.get_subscription_count() or self._markers.get_subscription_count()):
            return
        chosen = {target.id for target in scene.targets}
        height, width = np.atleast_2d(scene.labels).shape
        objects = [object_to_msg(object_, target=object_.id in chosen) for object_ in scene.objects]
        background = [part.background for part in scene.background]
        message = ObjectArray(height=height, width=width, objects=objects, background=background, **state)
        self._objects.publish(message)
        if drawn:  # an error must not refuse the cloud, which is answered
            markers = self._markers
            self._node.internal_errors.guarded("markers", lambda: markers.publish(object_markers(message, table)))()

    def diagnose(self, report: Report) -> None:
        """Report what the last click selected."""
        self._selection.diagnose(report)

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish that nothing was found, and why."""
        self._objects.publish(ObjectArray(header=header, status=status, reason=reason))
        self._table.publish(TablePlane(header=header, plane=plane_to_msg(None), status=status, reason=reason))
        self._object_cloud.publish(objects_to_msg((), header.frame_id, stamp_ns(header.stamp)))
