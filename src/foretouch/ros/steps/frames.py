# SPDX-License-Identifier: Apache-2.0
"""The frame that results are in: that of the cloud, or `output_frame`, in which tf or `camera_pose` has the camera.

What one step passes on to the next (`object_cloud`, `table`, `grasps`), and what is drawn, stays in the frame of the cloud: the model
needs the line of sight.
"""

import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from rclpy.time import Time
from std_msgs.msg import Header

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, GraspError
from foretouch.grasp.messages import rotation_from_quaternion
from foretouch.ros.messages.placement import Placement
from foretouch.ros.messages.requests import RefusalError, check_frames
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.types import Float64
from foretouch_msgs.msg import Status

_POLL_S: Final = 0.01


@dataclass(frozen=True, kw_only=True)
class FrameSettings(Settings):
    """Settings of the frame of the results."""

    output_frame: str = setting(
        "", "Frame of the results, with z up, such as base_link; empty: the frame of the cloud", read_only=True
    )
    camera_pose: tuple[float, ...] = setting(
        (),
        "x, y, z [m] and quaternion x, y, z, w of the optical frame of the clouds in output_frame; empty: tf has it",
        read_only=True,
    )
    tf_wait_s: float = setting(0.2, "Longest wait of a cloud for its transform", bounds=(0.0, 10.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.camera_pose and not self.output_frame:
            raise ConfigError("camera_pose: is a pose in output_frame, which is empty")
        if self.camera_pose:
            self.fixed_pose()

    def fixed_pose(self) -> Float64:
        """Return (4, 4) float64, the pose that is set; a `ConfigError` if it is none."""
        if len(self.camera_pose) != 7 or not np.isfinite(self.camera_pose).all():
            raise ConfigError(f"camera_pose: {list(self.camera_pose)} is not x, y, z and a quaternion x, y, z, w")
        pose = np.eye(4)
        pose[:3, 3] = self.camera_pose[:3]
        try:
            pose[:3, :3] = rotation_from_quaternion(np.array(self.camera_pose[3:]))
        except GraspError as err:
            raise ConfigError(f"camera_pose: {err}") from err
        return pose


class Frames:
    """Finds the frame of the results of a cloud.

    Args:
        node: Must be configuring, and its settings are `FrameSettings`.

    Raises:
        ConfigError: If tf is needed and not installed.
    """

    def __init__(self, node: ForetouchNode[Any]) -> None:
        config: FrameSettings = node.config
        self._node = node
        self._fixed = config.fixed_pose() if config.camera_pose else None
        self._buffer: Any = None
        if not config.output_frame or self._fixed is not None:
            return
        try:
            from tf2_ros import Buffer, TransformListener
        except ImportError as err:
            cure = "install ros-$ROS_DISTRO-tf2-ros-py, or set camera_pose"
            raise ConfigError(f"output_frame: {config.output_frame}: tf2_ros is not installed; {cure}") from err
        self._buffer = Buffer(node=node)  # which then follows the clock of the node, and offers the service tf2_frames
        node.closing.callback(self._buffer.jump_handle.unregister)
        node.closing.callback(node.destroy_service, self._buffer.srv)
        node.closing.callback(TransformListener(self._buffer, node).unregister)

    def placement(self, cloud: Header, frame: str = "") -> Placement:
        """Find the frame of the results of a cloud.

        Args:
            cloud: Its header.
            frame: Asked for; "" for `output_frame`.

        Raises:
            RefusalError: UNKNOWN_FRAME, if nothing transforms to it at the stamp of the cloud.
        """
        frame = frame or self._node.config.output_frame
        if frame in ("", cloud.frame_id):
            return Placement(cloud)
        header = Header(frame_id=frame, stamp=cloud.stamp)
        if self._fixed is not None and frame == self._node.config.output_frame:
            return Placement(header, self._fixed)
        if self._buffer is None:
            check_frames("cloud", header, cloud)
        return Placement(header, self._looked_up(header, cloud.frame_id))

    def _looked_up(self, header: Header, source: str) -> Float64:
        """Wait for a transform of tf: (4, 4) float64."""
        end = time.monotonic() + self._node.config.tf_wait_s
        names = header.frame_id, source, Time.from_msg(header.stamp)
        while not (known := self._buffer.can_transform(*names, return_debug_tuple=True))[0]:
            if time.monotonic() >= end:
                why = " ".join(str(known[1]).split())
                reason = f"no_transform: from {source!r} to {header.frame_id!r} at the stamp of the cloud: {why}"
                raise RefusalError(Status.UNKNOWN_FRAME, reason)
            time.sleep(_POLL_S)
        found = self._buffer.lookup_transform(*names).transform
        pose, (turn, shift) = np.eye(4), (found.rotation, found.translation)
        pose[:3, :3] = rotation_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))
        pose[:3, 3] = shift.x, shift.y, shift.z
        return pose
