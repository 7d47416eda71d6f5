# SPDX-License-Identifier: Apache-2.0
"""What the camera publishes, as clouds: depth images with their camera infos, or point clouds.

`depth/image` is a `sensor_msgs/Image` (16UC1, mono16 or 32FC1); remapped to a topic that ends with `/compressedDepth` it is what
image_transport publishes there. `depth/camera_info` is taken from beside the images, unless it is remapped too.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.cloud.io.depth_messages import CameraInfos, decode_depth, info_topic
from foretouch.cloud.messages import decode_cloud
from foretouch.config import Settings, setting
from foretouch.errors import CalibrationError, CloudError
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.types import Cloud, stamp_ns
from foretouch.types.camera import DepthImage
from foretouch.types.cloud import DepthCloud
from foretouch_msgs.msg import Status

_IMAGE_TOPIC: Final = "depth/image"
_INFO_TOPIC: Final = "depth/camera_info"
_POINTS_TOPIC: Final = "points"
_POLL_S: Final = 0.05


@dataclass(frozen=True, kw_only=True)
class CameraInputSettings(Settings):
    """Settings of what is received from the camera."""

    input: str = setting(
        "depth",
        "What is received: depth, the topics depth/image and depth/camera_info; points, the topic of clouds",
        choices=("depth", "points"),
        read_only=True,
    )
    frames: tuple[str, ...] = setting((), "Accepted frames of the clouds; if empty, every frame that has a name")


class CameraInput(Step):
    """Subscribes to the camera and makes clouds of its messages.

    Args:
        node: Subscribes; it must be configuring, and its settings are `CameraInputSettings`.
        receive: Called with each message that is to become a cloud.
    """

    def __init__(self, node: ForetouchNode[Any], receive: Callable[[Any], None]) -> None:
        self._node = node
        self._changed = threading.Condition()  # guards the infos
        self._last_report = ""  # about an info
        if node.config.input == "points":
            node.subscribe(InputTopic(_POINTS_TOPIC, PointCloud2, latched=None), receive)
            return
        images = node.resolve_topic_name(_IMAGE_TOPIC)
        infos = node.resolve_topic_name(_INFO_TOPIC)
        if infos == f"{node.get_namespace().rstrip('/')}/{_INFO_TOPIC}":  # not remapped
            infos = info_topic(images)
        self._infos = CameraInfos(images)
        node.subscribe(InputTopic(infos, CameraInfo, latched=None), self._receive_info)
        kind = CompressedImage if images.endswith("/compressedDepth") else Image
        node.subscribe(InputTopic(images, kind, latched=None), receive)

    def cloud(self, message: Any) -> Cloud:
        """Make the cloud of a message; waits for the first camera info for three seconds.

        Raises:
            RefusalError: If the message is malformed, its frame is not accepted, or its camera is not known.
        """
        frame, allowed = message.header.frame_id, self._node.config.frames
        if not frame:
            raise RefusalError(Status.UNKNOWN_FRAME, "header.frame_id: is empty, so the answer would have no frame")
        if allowed and frame not in allowed:
            raise RefusalError(Status.UNKNOWN_FRAME, f"header.frame_id: {frame!r} is not one of {', '.join(allowed)}")
        try:
            if isinstance(message, PointCloud2):
                return decode_cloud(message)
            depth = decode_depth(message)
            camera = self._camera(frame, depth.shape)
            image = DepthImage(depth, camera, copy=False)  # a view of the message, which nobody changes any more
            return DepthCloud.of(image, None, frame, stamp_ns(message.header.stamp))
        except CalibrationError as err:
            raise RefusalError(Status.BAD_CLOUD, f"{err.reason}: {err}") from err
        except CloudError as err:
            raise RefusalError(Status.BAD_CLOUD, str(err)) from err

    def diagnose(self, report: Report) -> None:
        """Repeat what was last logged about a camera info."""
        if self._last_report:
            report.values["camera_info"] = self._last_report

    def _camera(self, frame: str, shape: Any) -> Any:
        with self._changed:
            while True:
                try:
                    return self._infos.camera(frame, shape, time.monotonic())
                except CalibrationError as err:
                    if err.reason != "awaits_camera_info" or self._node.state_name != "active":
                        raise
                self._changed.wait(_POLL_S)

    def _receive_info(self, message: CameraInfo) -> None:
        with self._changed:
            report = self._infos.add(message, time.monotonic())
            self._changed.notify_all()
        if report:
            self._last_report = report
            self._node.get_logger().warning(report)
