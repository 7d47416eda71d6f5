# SPDX-License-Identifier: Apache-2.0
"""The frame that answers are published in, by default that of their cloud.

Its transform comes from tf2, looked up at the stamp of the cloud, or from a static hand-eye calibration, which needs
no tf2. An answer whose transform is missing is refused with a reason that begins with `no_transform`.
"""

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, GraspError, MissingDependencyError
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.hand_eye import read_hand_eye
from foretouch_msgs.msg import Status

NO_TRANSFORM = "no_transform"
"""First word of the reason where a transform is missing; the status is UNKNOWN_FRAME."""


@dataclass(frozen=True, kw_only=True)
class OutputFrameConfig(Settings):
    """Settings of nodes that publish poses."""

    output_frame: str = setting(
        "", "Frame of what is published, such as base_link; that of the cloud if empty", read_only=True
    )
    hand_eye: str = setting(
        "",
        "File with the pose of the camera in output_frame, of translation (m) and rotation (x, y, z, w), or of "
        "easy_handeye2; tf2 if empty",
        read_only=True,
    )
    transform_timeout_s: float = setting(
        0.1, "Longest wait for the transform of a cloud from tf2", unit="s", minimum=0.0, maximum=10.0, read_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hand_eye and not self.output_frame:
            raise ConfigError(f"{type(self).__name__}.hand_eye: {self.hand_eye!r} is given without output_frame")


class OutputFrame:
    """Finds the transform of each cloud. Thread-safe.

    Args:
        node: Its executor receives the transforms of tf2.
        config: Settings.

    Attributes:
        name: The frame; "" for that of the cloud.

    Raises:
        ConfigError: If the calibration cannot be used.
        MissingDependencyError: If tf2 is needed and not installed.
    """

    def __init__(self, node: Node, config: OutputFrameConfig) -> None:
        self.name = config.output_frame
        self._timeout = Duration(seconds=config.transform_timeout_s)
        self._calibration = read_hand_eye(config.hand_eye) if config.hand_eye else None
        self._tf2: Any = None
        if self._calibration is not None and self._calibration.target not in {"", self.name}:
            raise ConfigError(
                f"{config.hand_eye}: frame_id: {self._calibration.target!r} is not output_frame, {self.name!r}"
            )
        if self.name and self._calibration is None:
            self._tf2 = _import_tf2(self.name)
            self._buffer = self._tf2.Buffer()
            self._listener = self._tf2.TransformListener(self._buffer, node)

    def close(self) -> None:
        """End the subscriptions of tf2."""
        if self._tf2 is not None:
            self._listener.unregister()

    def notes(self) -> dict[str, str]:
        """The frame and the source of its transform, for /diagnostics; nothing for the frame of the cloud."""
        return (
            {"output_frame": f"{self.name} ({'tf2' if self._calibration is None else 'hand_eye'})"} if self.name else {}
        )

    def camera_frame(self, latest: str) -> str:
        """The frame of the clouds: that of the latest one, else as the calibration names it, if it does.

        Raises:
            RefusalError: UNKNOWN_FRAME, `no_transform`, if there is neither a cloud nor a calibration.
        """
        if latest:
            return latest
        if self._calibration is None:
            raise _refusal("the frame of the camera is not known before the first object_cloud")
        return self._calibration.source or "camera"

    def transform(self, cloud: Header) -> FrameTransform | None:
        """The transform of answers for a cloud; None if they stay in its frame.

        Raises:
            RefusalError: UNKNOWN_FRAME, with a reason that begins with `no_transform`.
        """
        if self.name in {"", cloud.frame_id}:
            return None
        if self._calibration is None:
            return self._looked_up(cloud)
        source = self._calibration.source
        if source not in {"", cloud.frame_id}:
            raise _refusal(f"hand_eye is for clouds in {source!r}, not in {cloud.frame_id!r}")
        return FrameTransform(self.name, cloud.frame_id, self._calibration.rotation, self._calibration.translation)

    def _looked_up(self, cloud: Header) -> FrameTransform:
        try:
            found = self._buffer.lookup_transform(
                self.name, cloud.frame_id, Time.from_msg(cloud.stamp), timeout=self._timeout
            ).transform
        except self._tf2.TransformException as err:
            raise _refusal(f"from {cloud.frame_id!r} to {self.name!r}: {' '.join(str(err).split())}") from err
        t, q = found.translation, found.rotation
        try:
            return FrameTransform.from_quaternion(
                self.name, cloud.frame_id, np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w])
            )
        except GraspError as err:
            raise _refusal(f"from {cloud.frame_id!r} to {self.name!r}: {err}") from err


def _refusal(reason: str) -> RefusalError:
    return RefusalError(Status.UNKNOWN_FRAME, f"{NO_TRANSFORM}: {reason}")


def _import_tf2(frame: str) -> Any:
    try:
        return importlib.import_module("tf2_ros")
    except ImportError as err:
        raise MissingDependencyError(
            f"output_frame: {frame!r} needs tf2_ros, which is not installed; install it with ROS 2, or give a calibration as "
            "hand_eye"
        ) from err
