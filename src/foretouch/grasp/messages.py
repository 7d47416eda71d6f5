# SPDX-License-Identifier: Apache-2.0
"""`foretouch_msgs/Grasp` without ROS: decoded alike from rclpy and rosbags."""

from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch.errors import GraspError
from foretouch.grasp.pose import quaternion_xyzw
from foretouch.types import Bool, Float64, Grasp

_MAX_UNIT: Final = 2.0  # no component of a rotation is larger; the square of such a number may overflow
_UNIT_TOLERANCE: Final = 1e-3  # of a quaternion's length; planners work with float32
_AGREEMENT: Final = 1e-3  # between a grasp's matrix and its quaternion, per element
_SURELY: Final = 0.999  # of a limit: below, rounding in another order makes no difference


def grasp_fields(grasp: Grasp) -> SimpleNamespace:
    """The fields of a `foretouch_msgs/Grasp`."""
    x, y, z, w = map(float, quaternion_xyzw(grasp.rotation))
    return SimpleNamespace(
        id=grasp.id,
        object_id=grasp.object_id,
        g1=_point(grasp.g1),
        g2=_point(grasp.g2),
        pose=SimpleNamespace(position=_point(grasp.midpoint), orientation=SimpleNamespace(x=x, y=y, z=z, w=w)),
        rotation=np.ascontiguousarray(grasp.rotation.reshape(9), np.float64),
        score=float(grasp.score),
        status=0,
        reason="",
    )


def _point(position: Any) -> SimpleNamespace:
    x, y, z = map(float, position)
    return SimpleNamespace(x=x, y=y, z=z)


def has_orientation(message: Any) -> bool:
    """Whether a `foretouch_msgs/Grasp` holds a rotation, as a matrix or as a quaternion."""
    return bool(np.any(_quaternion(message)) or np.any(message.rotation))


def decode_grasp(message: Any, rotation: Float64 | None = None) -> Grasp:
    """A `foretouch_msgs/Grasp`. The position of its pose is not used: it is the midpoint of the contacts.

    Args:
        message: With a matrix, a quaternion, or both; nine zeros as matrix mean that only the quaternion counts.
        rotation: (3, 3) float64, instead of that of the message.

    Raises:
        GraspError: If a number is not finite, the contacts are one point, or matrix and quaternion are absent or
            differ.
    """
    g1, g2 = (np.array([p.x, p.y, p.z], np.float64) for p in (message.g1, message.g2))
    rotation = _rotation_of(message) if rotation is None else rotation
    return Grasp(g1, g2, rotation, float(message.score), message.id, message.object_id)


def surely_sound(contacts: Float64, matrices: Float64) -> Bool:
    """(K,) whether (K, 2, 3) contacts are finite and apart and (K, 3, 3) matrices rotations; false close to a limit."""
    with np.errstate(all="ignore"):  # what is not finite is not sound
        skewed = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    apart = np.isfinite(contacts).all(axis=(1, 2)) & (contacts[:, 0] != contacts[:, 1]).any(axis=1)
    return np.asarray(apart & (skewed < _SURELY * _AGREEMENT), np.bool_)


def rotation_from_quaternion(xyzw: Float64) -> Float64:
    """(3, 3) float64 rotation of a quaternion (4,), whose length must be 1 within 1e-3, else a `GraspError`."""
    length = float(np.linalg.norm(xyzw)) if (np.abs(xyzw) <= _MAX_UNIT).all() else float(np.abs(xyzw).max())
    if not abs(length - 1.0) <= _UNIT_TOLERANCE:
        raise GraspError(f"orientation: length {length:g} of {xyzw.tolist()} is not 1")
    return _rotations(xyzw / length)


def _rotations(xyzw: Float64) -> Float64:
    """(..., 3, 3) rotations of unit quaternions (..., 4)."""
    x, y, z, w = (xyzw[..., k] for k in range(4))
    matrices = np.empty((*xyzw.shape[:-1], 3, 3))
    matrices[..., 0, 0], matrices[..., 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w)
    matrices[..., 0, 2], matrices[..., 1, 0] = 2 * (x * z + y * w), 2 * (x * y + z * w)
    matrices[..., 1, 1], matrices[..., 1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    matrices[..., 2, 0], matrices[..., 2, 1] = 2 * (x * z - y * w), 2 * (y * z + x * w)
    matrices[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return matrices


def _rotation_of(message: Any) -> Float64:
    quaternion = _quaternion(message)
    matrix = np.asarray(message.rotation, np.float64).reshape(3, 3)
    if not np.any(matrix):
        if not np.any(quaternion):
            raise GraspError("pose: no orientation")
        return rotation_from_quaternion(quaternion)
    require_rotation(matrix)
    if np.any(quaternion) and np.abs(rotation_from_quaternion(quaternion) - matrix).max() > _AGREEMENT:
        raise GraspError("rotation: is not that of pose.orientation")
    return matrix


def require_rotation(matrix: Float64) -> None:
    """Refuse a matrix (3, 3) whose columns are not of unit length and perpendicular within 1e-3, by a `GraspError`."""
    bounded = (np.abs(matrix) <= _MAX_UNIT).all()
    if not (bounded and np.abs(matrix @ matrix.T - np.eye(3)).max() <= _AGREEMENT):
        raise GraspError(f"rotation: {matrix.tolist()} is not a rotation")


def _quaternion(message: Any) -> Float64:
    q = message.pose.orientation
    return np.array([q.x, q.y, q.z, q.w], np.float64)
