# SPDX-License-Identifier: Apache-2.0
"""Publishes depth images from a RealSense that is connected, recorded or simulated, by the names of `realsense2_camera`.

Clouds are published on `points` while somebody subscribes to them, and with `camera.color` the colours of the images on
`color/image`, with their header.

Threads: one thread reads the camera (and so opens, waits for and reopens it) and publishes; the
executor's callbacks only read its status.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from foretouch.camera.config import RealSenseConfig, ScheduleConfig
from foretouch.camera.realsense import CameraStatus, RealSenseCamera
from foretouch.camera.source import SOURCES, ImageSource
from foretouch.camera.stream import DepthFrame
from foretouch.cloud.io.depth_messages import info_topic
from foretouch.config import setting
from foretouch.doors import needs_extras
from foretouch.errors import CloudError
from foretouch.ros.messages.clouds import cloud_to_msg, colours_to_msg, depth_to_msgs
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import NodeConfig, ThreadNode
from foretouch.topics import COLOUR_TOPIC

DEPTH_TOPIC: Final = "depth/image_rect_raw"
"""Of the depth images, as `realsense2_camera` names it; their infos are beside it."""


@dataclass(frozen=True, kw_only=True)
class CameraNodeConfig(NodeConfig):
    """Settings of the camera node."""

    source: str = setting(
        "device",
        "`device` (see `camera`), `scene` (see `scene`), another source of an installed package, or the path of a recording",
        read_only=True,
    )
    camera: RealSenseConfig = field(default_factory=RealSenseConfig)
    scene: ScheduleConfig = field(default_factory=ScheduleConfig)


class CameraNode(ThreadNode[CameraNodeConfig]):
    """Publishes depth images with their camera info, clouds where they are asked for, and the camera's state in /diagnostics."""

    default_name, config_class = "camera", CameraNodeConfig
    exclusive_topics = (DEPTH_TOPIC,)

    def __init__(self, **options: Any) -> None:
        self.synthetic: Any = None  # what feeds the camera, of a source that an installed package adds, such as `scene`
        self._camera: RealSenseCamera | None = None
        self._size: dict[str, int] = {}  # of the image, where it is set by a scene
        super().__init__(**options)

    def _setup(self) -> None:
        config = self.config
        if config.source != "device" and config.source in SOURCES:
            with needs_extras(f"source: {config.source}"):
                source: ImageSource = SOURCES.load(config.source, f"source: {config.source}")
                self.synthetic = source.device(config.scene, config.camera.fps, color=config.camera.color)
            self._size = dict(zip(("height", "width"), self.synthetic.shape, strict=True))
        self._image = self.advertise(Image, DEPTH_TOPIC)
        self._info = self.advertise(CameraInfo, info_topic(DEPTH_TOPIC))
        self._points = self.advertise(PointCloud2, "points")
        self._colours = self.advertise(Image, COLOUR_TOPIC) if config.camera.color else None

    def _start(self) -> None:
        config, source = self.config.camera.replace(**self._size), self.config.source
        if source != "device" and self.synthetic is None:
            config = config.replace(file=source)
        self._camera = RealSenseCamera(config, self.synthetic, self._log_status)
        if self.synthetic is not None:
            self.synthetic.start()

    def _stop(self) -> None:
        super()._stop()
        if self._camera is not None:
            self._camera.close()
            self._camera = None
        if self.synthetic is not None:
            self.synthetic.close()

    def _teardown(self) -> None:
        self.synthetic = None

    def has_ended(self) -> bool:
        """Return whether a recording was played to its end."""
        return (camera := self._camera) is not None and camera.status.state == "ended"

    def diagnose(self, report: Report) -> None:
        """Report the camera's state and counts, and why a scene is not shown."""
        report.values["source"] = self.config.source
        if self.synthetic is not None and (fault := self.synthetic.fault):
            report.warnings.append(fault)
        if self._camera is None:
            report.values["camera"] = "closed"
            return
        status = self._camera.status
        if not (status.is_ok or self.failure):
            report.errors.append(f"{status.state}: {status.reason}")
        report.values |= {"camera": status.state, "reason": status.reason, "device": status.device}
        report.values |= {"opened": str(status.opened), "failures": str(status.failures)}
        if self._colours is not None:
            report.values["without_color"] = str(status.colourless)

    # The thread.

    def _run(self) -> None:
        """Read the device until it does not offer what the settings ask for."""
        camera = self._camera
        assert camera is not None  # noqa: S101  made by start
        counted: Counter[str] = Counter()
        while not self.stopping.is_set() and camera.status.state != "ended":
            frame = camera.read(0.1)  # then the thread checks whether it should end
            for reason, count in camera.status.dropped.items():
                for _ in range(count - counted[reason]):
                    self.statistics.receive()
                    self.statistics.drop(reason)
                counted[reason] = count
            if frame is not None:
                arrived, age_s = self.statistics.receive(), self.age_s(frame.stamp_ns)
                self._publish(frame)
                self.statistics.use(arrived, age_s)

    def _publish(self, frame: DepthFrame) -> None:
        image, info = depth_to_msgs(frame)
        self._info.publish(info)  # first, so that no image waits for it
        if self._colours is not None and frame.rgb is not None and self._colours.get_subscription_count():
            self._colours.publish(colours_to_msg(image.header, frame.rgb))
        self._image.publish(image)
        if self._points.get_subscription_count():
            try:
                self._points.publish(cloud_to_msg(frame.cloud()))
            except CloudError as err:
                self.get_logger().warning(f"points: {err}")

    def _log_status(self, status: CameraStatus) -> None:
        if status.is_ok:
            self.get_logger().info(str(status))
        else:
            self.get_logger().warning(str(status))
