# SPDX-License-Identifier: Apache-2.0
"""Rotation matrices: which are none, and their quaternions."""

from collections.abc import Callable

import numpy as np

from foretouch.errors import GraspError
from foretouch.types.arrays import Bool, Float64

_IDENTITY = np.eye(3)
_SKEWED = 1e-3  # largest deviation of a rotation times its transpose from the identity


def quaternion_xyzw(rotation: Float64) -> Float64:
    """Return the unit quaternion of a rotation, in the order of ROS messages.

    Args:
        rotation: (3, 3) floating, proper rotation.

    Returns:
        (4,) float64: x, y, z, w with w >= 0; a half turn has its first non-zero component positive.

    Raises:
        GraspError: If the matrix is not a proper rotation within 1e-3, or not finite.
    """
    r = np.asarray(rotation, np.float64)
    check_rotation(r)
    squares = np.array(
        [
            1.0 + r[0, 0] - r[1, 1] - r[2, 2],
            1.0 - r[0, 0] + r[1, 1] - r[2, 2],
            1.0 - r[0, 0] - r[1, 1] + r[2, 2],
            1.0 + r[0, 0] + r[1, 1] + r[2, 2],
        ]
    )  # 4x², 4y², 4z², 4w²
    # The row of 4qqᵀ with the largest diagonal loses the fewest digits (Shepperd 1978).
    xy, xz, yz = r[1, 0] + r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2]
    xw, yw, zw = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    rows = np.array(
        [[squares[0], xy, xz, xw], [xy, squares[1], yz, yw], [xz, yz, squares[2], zw], [xw, yw, zw, squares[3]]]
    )
    q = rows[np.argmax(squares)]
    q = q / np.linalg.norm(q)
    leading = q[3] if abs(q[3]) > 1e-12 else q[np.flatnonzero(np.abs(q) > 1e-12)[0]]
    return np.asarray(-q if leading < 0 else q, np.float64)


def check_rotation(rotation: Float64) -> None:
    """Check that a matrix is a proper rotation within 1e-3.

    Raises:
        GraspError: If it is not given, not (3, 3), not finite, skewed, scaled or left-handed.
    """
    if rotation.shape == (3, 3) and not rotation.any():
        raise GraspError("rotation: is not given; a prediction on an object computes it (predictions.grasps)")
    if rotation.shape != (3, 3) or not is_rotation(rotation):
        raise GraspError(f"rotation: {rotation.tolist()} is not a rotation matrix")


def is_rotation(rotation: Float64) -> bool:
    """Return whether a matrix (3, 3) is a proper rotation within 1e-3: the rule of `are_rotations`, in a tenth of its time."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    lengths = (a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0)
    angles = (a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i)
    handed = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return all(abs(skewed) <= _SKEWED for skewed in (*lengths, *angles)) and handed > 0.0


def are_rotations(rotations: Float64) -> Bool:
    """Return (K,) bool, which of (K, 3, 3) matrices are proper rotations within 1e-3."""
    with np.errstate(all="ignore"):  # what overflows or is not finite is no rotation
        skewed = np.abs(rotations @ rotations.transpose(0, 2, 1) - _IDENTITY).max(axis=(1, 2))
        x, y, z = rotations[:, :, 0].T, rotations[:, :, 1].T, rotations[:, :, 2].T
        handed = (
            x[0] * (y[1] * z[2] - y[2] * z[1]) + x[1] * (y[2] * z[0] - y[0] * z[2]) + x[2] * (y[0] * z[1] - y[1] * z[0])
        )
        return np.asarray((skewed <= _SKEWED) & (handed > 0.0), np.bool_)


def rotation_faults(rotations: Float64) -> list[str]:
    """Say which of (K, 3, 3) matrices are no proper rotations within 1e-3, of each; "" for those that are."""
    return fault_texts(
        are_rotations(rotations), lambda k: f"rotation: {rotations[k].tolist()} is not a rotation matrix"
    )


def are_absent(rotations: Float64) -> Bool:
    """Return (K,) bool, which of (K, 3, 3) matrices are zero: the rotation is not given, as in a `foretouch_msgs/Grasp`."""
    return np.asarray(~rotations.any(axis=(1, 2)), np.bool_)


def require_rotations(rotations: Float64) -> None:
    """Refuse (K, 3, 3) matrices with one that is no rotation, but for those that are absent, and rows that are not finite.

    Raises:
        GraspError: With the first such matrix.
    """
    if not (proper := are_rotations(rotations)).all():
        passed = proper | are_absent(rotations) | ~np.isfinite(rotations).all(axis=(1, 2))
        require_none(rotation_faults(rotations[~passed][:1]))


def require_none(faults: list[str]) -> None:
    """Raise a `GraspError` with the first fault, if there is one."""
    if first := next(filter(None, faults), ""):
        raise GraspError(first)


def fault_texts(fine: Bool, text: Callable[[int], str]) -> list[str]:
    """Return the text of each row that is not fine, "" for the others."""
    if fine.all():
        return [""] * len(fine)
    return ["" if is_fine else text(k) for k, is_fine in enumerate(fine.tolist())]
