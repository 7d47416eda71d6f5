# SPDX-License-Identifier: Apache-2.0
"""Rotations of the hand and its fingertips at two contacts (GeoGrasp = Zapata-Impata et al. 2019; P2 calls its rotation R)."""

import math

import numpy as np

from foretouch.errors import GraspError
from foretouch.tactile.layout import Layout
from foretouch.types import SQUARABLE, Float64, Grasp, Grasps
from foretouch.types.rotations import fault_texts

_PARALLEL_SINE = 1e-6  # below this sine of the angle, Z x axis is rounding noise, not a direction
_LEAST_M = 1e-12  # from the midpoint to a contact; shorter vectors have no certain direction
_TILTED_DEG = 30.0  # fingers of a hand that is tilted further against the line of its contacts do not close on both


def cross(a: Float64, b: Float64) -> Float64:
    """Return the cross product of two vectors (3,), with the bits of np.cross in a tenth of its time."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def is_parallel(g1: Float64, g2: Float64, axis: Float64) -> bool:
    """Return whether the line through the contacts is parallel to the object's axis, which leaves the hand's X undefined."""
    return bool(np.linalg.norm(cross(_unit(g1 - g2, "g1 - g2"), _unit(axis, "axis"))) < _PARALLEL_SINE)


def hand_rotation(g1: Float64, g2: Float64, axis: Float64) -> Float64:
    """Return the rotation of the hand: Z = g1 - g2, X = Z x axis, Y = Z x X, each of unit length.

    If Z is parallel to the axis, X would be zero. By convention the coordinate axis that is least
    aligned with Z (the first of equal ones) then replaces the object's axis.

    Args:
        g1: (3,) floating [m], contact of the first finger.
        g2: (3,) floating [m], contact of the second finger, the same frame.
        axis: (3,) floating, the object's axis, of any length, the same frame.

    Returns:
        (3, 3) float64, proper rotation; its columns are the hand's X, Y, Z in the frame of the contacts.

    Raises:
        GraspError: If the contacts coincide, the axis has no length, or a number is not finite.
    """
    z = _unit(np.asarray(g1, np.float64) - np.asarray(g2, np.float64), "g1 - g2")
    x = cross(z, _unit(np.asarray(axis, np.float64), "axis"))
    if _norm(x) < _PARALLEL_SINE:
        x = cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= _norm(x)
    y = cross(z, x)
    return np.array([x, y / _norm(y), z]).T.copy()


def closing_faults(grasps: Grasps) -> list[str]:
    """Say which fingers of K grasps do not close along the line of the contacts, with the hand's Z within 30 degrees of g1 - g2.

    The angle of each and what is along the line instead, "" where they do.
    """
    along = grasps.g1 - grasps.g2
    with np.errstate(all="ignore"):
        along = along / np.abs(along).max(axis=1, keepdims=True)  # so that no square overflows
        cosine = (along * grasps.rotation[:, :, 2]).sum(axis=1) / np.sqrt((along**2).sum(axis=1))
        angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    rule = f"degrees from g1 - g2, more than {_TILTED_DEG:g}"

    def text(k: int) -> str:
        return f"pose: its Z is {angles[k]:.0f} {rule}; {_closing_cure(along[k], grasps.rotation[k])}"

    return fault_texts(angles <= _TILTED_DEG, text)


def _closing_cure(along: Float64, rotation: Float64) -> str:
    """Say what of a rotation (3, 3) is along the line of the contacts (3,) instead of its third column, and what to do."""
    along = along / np.linalg.norm(along)
    (x, y, z), (_, _, third_row) = along @ rotation, rotation @ along
    rule = "the columns are X, Y, Z, and Z, the third, runs from g2 to g1"
    cures = {
        "g1 and g2 are exchanged, or the hand is turned round: exchange them": -z,
        f"the first column is along it: {rule}": abs(x),
        f"the second column is along it: {rule}": abs(y),
        "the third row is along it: give columns, not rows": abs(third_row),
    }
    cure = max(cures, key=lambda text: float(cures[text]))
    return cure if cures[cure] >= math.cos(math.radians(_TILTED_DEG)) else rule


def joined_faults(*parts: list[str]) -> list[str]:
    """Return the first fault of each of K grasps in several lists of K; "" without a fault."""
    faulty = [part for part in parts if any(part)]
    return [next(filter(None, row), "") for row in zip(*faulty, strict=True)] if faulty else parts[0]


def fingertip_rotation(grasp: Grasp, contact: Float64) -> Float64:
    """Return (3, 3) orientation in which a fingertip is drawn at a contact of a grasp, its g1 or g2 (3,) [m].

    Its pad faces the other contact (-z), its tip points away from the camera (x). The true orientation depends on the
    hand; P2's data hold contacts only.
    """
    z = contact - grasp.midpoint
    if np.linalg.norm(z) < _LEAST_M:  # a hand that is closed
        z = grasp.rotation[:, 2] if np.array_equal(contact, grasp.g1) else -grasp.rotation[:, 2]
    z = z / np.linalg.norm(z)
    across = grasp.rotation - np.outer(z, z @ grasp.rotation)  # the hand's axes, each without its part along z
    x = across[:, 0] if np.linalg.norm(across[:, 0]) > _PARALLEL_SINE else across[:, 1]
    x = x / np.linalg.norm(x)
    if x @ grasp.midpoint < 0.0:  # the camera is at the origin
        x = -x
    return np.column_stack([x, np.cross(z, x), z])


def taxels_at(layout: Layout, grasp: Grasp, contact: Float64, lift_m: float = 0.0) -> Float64:
    """Return (N, 3) positions of the taxels of a fingertip at a contact of a grasp, its g1 or g2 (3,) [m].

    Oriented as `fingertip_rotation`; the outermost taxels, on the surface of the pad, are at the contact. `lift_m` moves
    each along its normal.
    """
    positions = (layout.positions + lift_m * layout.normals) @ layout.to_fingertip.T
    positions -= [positions[:, 0].mean(), 0.0, positions[:, 2].min()]
    return np.asarray(positions @ fingertip_rotation(grasp, contact).T + contact, np.float64)


def _unit(vector: Float64, name: str) -> Float64:
    sizes = [abs(size) for size in vector.tolist()]  # plain floats take a fifth of NumPy's time
    largest = max(sizes)
    if not all(map(math.isfinite, sizes)) or largest == 0.0:
        raise GraspError(f"{name}: {np.asarray(vector).tolist()} has no direction")
    if not SQUARABLE[0] < largest < SQUARABLE[1]:
        vector = vector / largest
    return np.asarray(vector / _norm(vector), np.float64)


def _norm(vector: Float64) -> float:
    """Return the length of a vector (3,), with the bits of np.linalg.norm in a quarter of its time."""
    return math.sqrt(vector.dot(vector))
