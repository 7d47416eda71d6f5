# SPDX-License-Identifier: Apache-2.0
"""Cloud -> `objects`, `table`, `object_cloud`: the objects on the table, and which of them to grasp.

A person or another node says more about the objects on the topics `mask` and `clicked_point`. A mask holds the labels of the objects of
one image. A point that is clicked in RViz (*Publish Point*) selects an object, which stays the target by its id until it is gone or
another one is clicked. Callbacks only store messages.
"""

import array
import importlib
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.cloud.io.mask_files import decode_mask
from foretouch.cloud.segmentation.objects import TargetConfig
from foretouch.cloud.segmentation.segment import SegmentationConfig
from foretouch.config import Settings, setting
from foretouch.errors import CloudError
from foretouch.grasp import CarriedConfig, GeoGraspConfig, HandConfig
from foretouch.ros.messages.clouds import (
    detections_to_msg,
    labels_to_msg,
    object_to_msg,
    objects_to_msg,
    overlay_to_msg,
)
from foretouch.ros.messages.conversions import obstacles_to_msg, plane_to_msg
from foretouch.ros.messages.markers import object_markers
from foretouch.ros.messages.placement import Placement
from foretouch.ros.messages.requests import RefusalError, status_code
from foretouch.ros.messages.tactile import message_class
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step, warm_up_cloud
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.steps.frames import FrameSettings
from foretouch.ros.steps.grasping import stream_config
from foretouch.stream import Stream
from foretouch.topics import CLOUD_TOPIC
from foretouch.types import AnyArray, Cloud, Grasp, stamp_ns
from foretouch.types.scene import Object, Scene
from foretouch_msgs.msg import ObjectArray, Status, TablePlane

_MASK_TOPIC: Final = "mask"
_CLICK_TOPIC: Final = "clicked_point"
_MASKS: Final = 16  # that wait for the image of their stamp


@dataclass(frozen=True, kw_only=True)
class SelectionSettings(Settings):
    """Settings of masks and clicks."""

    mask: str = setting(
        "none",
        "Labels of the objects on the topic mask: none, objects are found here; same_stamp, each cloud waits for the mask of "
        "its stamp; latest, the last mask is used for every cloud",
        choices=("none", "same_stamp", "latest"),
        read_only=True,
    )
    mask_wait_s: float = setting(1.0, "Longest wait of a cloud for the mask of its stamp", bounds=(0.0, 60.0))
    click_age_s: float = setting(10.0, "Clicked points that are older are refused", bounds=(0.1, 3600.0))


class Selection:
    """Masks and clicks of one stream of clouds.

    Args:
        node: Subscribes; it must be configuring, and its settings are `SelectionSettings`.
        stream: Of the clouds, in which a click selects.
    """

    def __init__(self, node: ForetouchNode[Any], stream: Stream) -> None:
        self._node, self._stream = node, stream
        self._changed = threading.Condition()  # guards what callbacks store
        self._masks: dict[int, Image] = {}  # by stamp
        self._click: PointStamped | None = None  # that no cloud has seen yet
        self._refused = ""  # why the last click selected nothing
        if node.config.mask != "none":
            node.subscribe(InputTopic(_MASK_TOPIC, Image, latched=None), self._receive_mask)
        node.subscribe(InputTopic(_CLICK_TOPIC, PointStamped), self._receive_click)

    def diagnose(self, report: Report) -> None:
        """Report what the last click selected, or why it was refused."""
        if note := self._refused or self._stream.note:
            report.values[_CLICK_TOPIC] = note

    def mask(self, cloud: Cloud) -> AnyArray | None:
        """Find the labels for a cloud; None where objects are found without.

        Raises:
            RefusalError: If there is no mask for it, or it cannot be read or is of another frame.
        """
        config = self._node.config
        if config.mask == "none":
            return None
        with self._changed:
            if config.mask == "latest":
                message = next(reversed(self._masks.values()), None)
            else:
                end = time.monotonic() + config.mask_wait_s
                while cloud.stamp_ns not in self._masks and (left := end - time.monotonic()) > 0.0:
                    self._changed.wait(left)
                message = self._masks.get(cloud.stamp_ns)
        if message is None:
            which = (
                "mask came yet"
                if config.mask == "latest"
                else f"mask of this stamp came within {config.mask_wait_s:g} s"
            )
            raise RefusalError(Status.BAD_REQUEST, f"mask: no {which} on {self._node.resolve_topic_name(_MASK_TOPIC)}")
        if (frame := message.header.frame_id) not in ("", cloud.frame_id):
            rule = f"is not the frame of the image, {cloud.frame_id!r}: label the pixels of the depth image"
            raise RefusalError(Status.UNKNOWN_FRAME, f"mask: frame {frame!r} {rule}")
        try:
            return decode_mask(message)
        except CloudError as err:
            raise RefusalError(Status.BAD_REQUEST, str(err)) from err

    def take_click(self, scene: Scene) -> None:
        """Select the object that was clicked since the scene before, if there is one."""
        with self._changed:
            click, self._click = self._click, None
        if click is not None:
            self._take(click, scene)

    def _take(self, click: PointStamped, scene: Scene) -> None:
        """Select the object at a clicked point, or report why none is selected."""
        try:
            frame = click.header.frame_id
            if frame != scene.cloud.frame_id:
                raise CloudError(
                    f"frame {frame!r} is not the frame of the clouds, {scene.cloud.frame_id!r}; set RViz's fixed frame to it"
                )
            age_s = self._node.age_s(stamp_ns(click.header.stamp))
            if stamp_ns(click.header.stamp) and age_s > self._node.config.click_age_s:
                raise CloudError(f"is {age_s:.0f} s old, more than click_age_s {self._node.config.click_age_s:g}")
            point = [click.point.x, click.point.y, click.point.z]
            tolerance_m = self._node.config.target.tolerance_m
            chosen = scene.near(point, tolerance_m)
        except CloudError as err:
            self._refused = f"refused: {err}"
            self._node.get_logger().warning(f"{_CLICK_TOPIC}: {err}")
            return
        self._refused = ""
        self._stream.select(chosen.id)
        self._node.get_logger().info(f"{_CLICK_TOPIC}: object {chosen.id} is the target")

    def _receive_mask(self, message: Image) -> None:
        with self._changed:
            self._masks.pop(stamp_ns(message.header.stamp), None)
            self._masks[stamp_ns(message.header.stamp)] = message
            while len(self._masks) > _MASKS:
                del self._masks[next(iter(self._masks))]
            self._changed.notify_all()

    def _receive_click(self, message: PointStamped) -> None:
        with self._changed:
            self._click = message


@dataclass(frozen=True, kw_only=True)
class SegmentationSettings(SelectionSettings, FrameSettings):
    """Settings of the segmentation."""

    publish_detections: bool = setting(
        False, "Whether detections is offered: the objects as vision_msgs/Detection3DArray", read_only=True
    )
    publish_labels: bool = setting(
        False, "Whether labels is offered: the object of each pixel as sensor_msgs/Image, 16UC1", read_only=True
    )
    publish_overlay: bool = setting(
        False,
        "Whether overlay is offered: the image with the objects in colours, their ids and the first grasp, rgb8",
        read_only=True,
    )

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    limits: ObjectLimits = ObjectLimits()  # with which `target.mode` free plans grasps
    grasp: GeoGraspConfig = GeoGraspConfig()  # the same
    hand: HandConfig = HandConfig()  # the same
    object: CarriedConfig = CarriedConfig()  # the same


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
        config: SegmentationSettings = node.config
        self._labels = node.advertise(Image, "labels") if config.publish_labels else None
        self._overlay = node.advertise(Image, "overlay") if config.publish_overlay else None
        self._detections = None
        if config.publish_detections:
            self._detections = node.advertise(message_class("vision_msgs/Detection3DArray"), "detections")
        self._selection = Selection(node, stream)
        stream.pipeline.segment(warm_up_cloud())

    @property
    def shows_colours(self) -> bool:
        """Whether somebody subscribes to what has the colours of the cloud: its points, or the image that is drawn over."""
        shown = (self._object_cloud, self._overlay)
        return any(publisher is not None and publisher.get_subscription_count() for publisher in shown)

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

    def publish(self, header: Header, scene: Scene, placement: Placement, grasp: Grasp | None = None) -> None:
        """Publish a scene for those who subscribe.

        Args:
            header: Of the cloud.
            scene: Found in it.
            placement: Of the objects; table, points, images and markers are in the frame of the cloud.
            grasp: The first one that was planned, for the overlay; None without.
        """
        self._publish_detections(scene.objects, placement)
        for images, make in ((self._labels, labels_to_msg), (self._overlay, partial(overlay_to_msg, grasp=grasp))):
            if images is not None and images.get_subscription_count():
                images.publish(make(scene, header))
        table = self._publish_table(header, scene)
        if self._object_cloud.get_subscription_count():
            self._object_cloud.publish(objects_to_msg(scene.targets, header.frame_id, stamp_ns(header.stamp)))
        if self._objects.get_subscription_count():
            self._objects.publish(_objects_to_msg(scene, placement))
        if self._markers.get_subscription_count() and table is not None:
            # An error must not refuse the cloud, which is answered.
            self._node.internal_errors.guarded("markers", self._draw)(_objects_to_msg(scene, Placement(header)), table)

    def _publish_table(self, header: Header, scene: Scene) -> TablePlane | None:
        """Publish the table, and return it where it or the markers have a subscriber."""
        if not (self._table.get_subscription_count() or self._markers.get_subscription_count()):
            return None
        outline = array.array("f", scene.outline.astype(np.float32).tobytes())
        plane, obstacles = plane_to_msg(scene.table), obstacles_to_msg(scene.obstacles)
        state = {"status": status_code(scene.status), "reason": scene.reason}
        table = TablePlane(header=header, plane=plane, outline=outline, **obstacles, **state)
        self._table.publish(table)
        return table

    def _draw(self, objects: ObjectArray, table: TablePlane) -> None:
        self._markers.publish(object_markers(objects, table))

    def _publish_detections(self, objects: Sequence[Object], placement: Placement) -> None:
        if self._detections is not None and self._detections.get_subscription_count():
            kinds = importlib.import_module("vision_msgs.msg")
            self._detections.publish(detections_to_msg(objects, placement, kinds))

    def diagnose(self, report: Report) -> None:
        """Report what the last click selected."""
        self._selection.diagnose(report)

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish that nothing was found, and why."""
        self._objects.publish(ObjectArray(header=header, status=status, reason=reason))
        self._table.publish(TablePlane(header=header, plane=plane_to_msg(None), status=status, reason=reason))
        self._object_cloud.publish(objects_to_msg((), header.frame_id, stamp_ns(header.stamp)))
        self._publish_detections((), Placement(header))


def _objects_to_msg(scene: Scene, placement: Placement) -> ObjectArray:
    chosen = {target.id for target in scene.targets}
    height, width = np.atleast_2d(scene.labels).shape
    return ObjectArray(
        header=placement.header,
        height=height,
        width=width,
        objects=[object_to_msg(object_, placement, target=object_.id in chosen) for object_ in scene.objects],
        status=status_code(scene.status),
        reason=scene.reason,
        background=[part.background for part in scene.background],
    )
