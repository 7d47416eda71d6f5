# SPDX-License-Identifier: Apache-2.0
"""Results in another frame than that of the cloud. Pure functions without a node."""

from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import Pose, PoseArray
from std_msgs.msg import Header

from foretouch.errors import GraspError
from foretouch.grasp.hand import tool_of
from foretouch.grasp.messages import decode_grasp, has_orientation
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.types import Float64, Floating
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import GraspArray


class Placement(NamedTuple):
    """The frame that results of one cloud are in."""

    header: Header  # of the results: their frame, and the stamp of the cloud
    pose: Float64 | None = None  # (4, 4) float64, of the cloud's frame in this one; None where both are the same

    @property
    def back(self) -> Float64 | None:
        """(4, 4) float64, the pose of this frame in that of the cloud; None where both are the same."""
        return None if self.pose is None else np.asarray(np.linalg.inv(self.pose), np.float64)

    @property
    def up(self) -> Float64 | None:
        """(3,) float64, what is up (the frame's z) in the frame of the cloud; None where both are the same."""
        return None if self.pose is None else self.pose[2, :3].copy()

    def points(self, xyz: Floating) -> Float64:
        """Move (..., 3) points of the cloud [m], float64."""
        moved = xyz if self.pose is None else xyz @ self.pose[:3, :3].T + self.pose[:3, 3]
        return np.asarray(moved, np.float64)


def tool_pose(grasp: GraspMsg) -> Pose:
    """Return what an arm is sent to: the pose of the tool frame of a described hand; without one, of the hand by GeoGrasp."""
    return grasp.pose_of_hand if tool_of(grasp.hand) else grasp.pose


def poses_to_msg(message: GraspArray, placement: Placement) -> PoseArray:
    """Convert grasps to the poses that an arm is sent to, best first."""
    moved = [moved_grasp(grasp, placement.pose) for grasp in message.grasps]
    return PoseArray(header=placement.header, poses=[tool_pose(grasp) for grasp in moved])


def moved_grasp(message: GraspMsg, pose: Float64 | None) -> GraspMsg:
    """Express a grasp in another frame; one that is none, and an orientation that is not given, stay as they are.

    Args:
        message: The grasp.
        pose: (4, 4) float64, of its frame in the other one; None changes nothing.
    """
    if pose is None:
        return message
    turned = has_orientation(message)
    try:
        grasp = decode_grasp(message, None if turned else np.eye(3))
    except GraspError:
        return message
    moved = grasp_to_msg(grasp.moved(pose), message.status, message.reason)
    if not turned:
        moved.pose.orientation, moved.rotation = message.pose.orientation, message.rotation
    return moved
