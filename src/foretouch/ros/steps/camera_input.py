# SPDX-License-Identifier: Apache-2.0
"""What the camera publishes, as clouds: depth images with their camera infos, or point clouds.

`depth/image` is a `sensor_msgs/Image` (16UC1, mono16 or 32FC1); remapped to a topic that ends with `/compressedDepth` it is what
image_transport publishes there. `depth/camera_info` is taken from beside the images, unless it is remapped too.

`color/image` has the colours of the same pixels: a `sensor_msgs/Image`, or remapped to a topic that ends with `/compressed` a
`CompressedImage`. They are received only while they are drawn, published or used by the model, and matched with the depth images
by their stamps (`ColourImages`). A depth image is answered with or without them.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.cloud.io.colours import TOLERANCE_S, ColourImages
from foretouch.cloud.io.depth_messages import CameraInfos, decode_depth, info_topic
from foretouch.cloud.messages import decode_cloud
from foretouch.config import Settings, setting
from foretouch.errors import CalibrationError, CloudError
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.topics import COLOUR_TOPIC
from foretouch.types import Cloud, UInt8, stamp_ns
from foretouch.types.camera import DepthImage
from foretouch.types.cloud import DepthCloud
from foretouch_msgs.msg import Status

_IMAGE_TOPIC: Final = "depth/image"
_INFO_TOPIC: Final = "depth/camera_info"
_POINTS_TOPIC: Final = "points"
_POLL_S: Final = 0.05
_SILENT_S: Final = 1.0  # without a colour image, after which no depth image waits for one
_RECENT_S: Final = 5.0  # for which a depth image without its colours is a warning


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
    color_tolerance_s: float = setting(
        TOLERANCE_S,
        "Largest difference between the stamps of a depth image and its colours, where none has the same stamp",
        bounds=(0.0, 1.0),
        read_only=True,
    )
    color_wait_s: float = setting(
        0.1,
        "Longest wait of a depth image for its colours, where they are drawn, published or used; then it is answered without",
        bounds=(0.0, 1.0),
    )


class CameraInput(Step):
    """Subscribes to the camera and makes clouds of its messages.

    Args:
        node: Subscribes; it must be configuring, and its settings are `CameraInputSettings`.
        receive: Called with each message that is to become a cloud.
        shows_colours: Returns whether somebody looks at the colours of the clouds now.
    """

    def __init__(
        self, node: ForetouchNode[Any], receive: Callable[[Any], None], shows_colours: Callable[[], bool]
    ) -> None:
        self._node = node
        self._shows_colours = shows_colours
        self._changed = threading.Condition()  # guards the infos and the colours
        self._last_report = ""  # about an info
        if node.config.input == "points":
            node.subscribe(InputTopic(_POINTS_TOPIC, PointCloud2, latched=None), receive)
            return
        images = node.resolve_topic_name(_IMAGE_TOPIC)
        infos = node.resolve_topic_name(_INFO_TOPIC) if self._remapped(_INFO_TOPIC) else info_topic(images)
        if self._remapped(_POINTS_TOPIC) and not self._remapped(_IMAGE_TOPIC):
            clouds = node.resolve_topic_name(_POINTS_TOPIC)
            node.get_logger().warning(f"{clouds} is not received: input is depth; set input:=points for clouds")
        self._infos = CameraInfos(images)
        node.subscribe(InputTopic(infos, CameraInfo, latched=None), self._receive_info)
        kind = CompressedImage if images.endswith("/compressedDepth") else Image
        node.subscribe(InputTopic(images, kind, latched=None), receive)
        self._colours = ColourImages(node.config.color_tolerance_s)
        self._colour_s = -math.inf  # when the last colour image arrived, `time.monotonic` [s]
        self._received = 0  # colour images
        self._colourless_s = -math.inf  # when a depth image was last without its colours, `time.monotonic` [s]
        self._receives_colours = False
        self.look()

    def look(self) -> None:
        """Receive colours while somebody looks at them."""
        if self._node.config.input != "depth" or self._receives_colours == self._shows_colours():
            return
        self._receives_colours = not self._receives_colours
        topic = self._node.resolve_topic_name(COLOUR_TOPIC)
        if self._receives_colours:
            kind = CompressedImage if topic.endswith("/compressed") else Image
            self._node.subscribe(InputTopic(topic, kind, latched=None), self._receive_colours)
        else:
            self._node.unsubscribe(topic)

    def _remapped(self, topic: str) -> bool:
        """Return whether a topic has another name than its own in the namespace of the node."""
        return self._node.resolve_topic_name(topic) != f"{self._node.get_namespace().rstrip('/')}/{topic}"

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
            stamp = stamp_ns(message.header.stamp)
            return DepthCloud.of(image, self._colours_of(frame, image.shape, stamp), frame, stamp)
        except CalibrationError as err:
            raise RefusalError(Status.BAD_CLOUD, f"{err.reason}: {err}") from err
        except CloudError as err:
            raise RefusalError(Status.BAD_CLOUD, str(err)) from err

    def diagnose(self, report: Report) -> None:
        """Repeat what was last logged about a camera info, count colours, and say why a depth image has none."""
        if self._last_report:
            report.values["camera_info"] = self._last_report
        if self._node.config.input == "depth" and self._received:
            counts = {"received": self._received, **self._colours.counts}
            report.values |= {f"color.{name}": str(count) for name, count in counts.items()}
            if time.monotonic() - self._colourless_s < _RECENT_S:
                report.warnings.append(f"{COLOUR_TOPIC}: {self._colours.fault}")

    def _camera(self, frame: str, shape: Any) -> Any:
        with self._changed:
            while True:
                try:
                    return self._infos.camera(frame, shape, time.monotonic())
                except CalibrationError as err:
                    if err.reason != "awaits_camera_info" or self._node.state_name != "active":
                        raise
                self._changed.wait(_POLL_S)

    def _receive_colours(self, message: Any) -> None:
        with self._changed:
            self._colours.add(stamp_ns(message.header.stamp), message)
            self._colour_s = time.monotonic()
            self._received += 1
            self._changed.notify_all()

    def _colours_of(self, frame: str, shape: tuple[int, int], stamp: int) -> UInt8 | None:
        """Return the colours (H, W, 3) of a depth image, after a wait of `color_wait_s` at most; None without any, or where nobody looks."""
        if not (self._received and self._receives_colours):
            return None
        until_s, colours = time.monotonic() + self._node.config.color_wait_s, self._colours
        with self._changed:
            while not colours.is_final(stamp):
                now_s = time.monotonic()
                if now_s >= until_s or now_s - self._colour_s > _SILENT_S:
                    break
                self._changed.wait(min(until_s - now_s, _POLL_S))
            found = colours.match(stamp)
        decoded = None if found is None else colours.decode(found, frame, shape)
        if decoded is None:
            self._colourless_s = time.monotonic()
        return decoded

    def _receive_info(self, message: CameraInfo) -> None:
        with self._changed:
            report = self._infos.add(message, time.monotonic())
            self._changed.notify_all()
        if report:
            self._last_report = report
            self._node.get_logger().warning(report)
