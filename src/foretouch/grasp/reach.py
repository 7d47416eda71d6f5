# SPDX-License-Identifier: Apache-2.0
"""Whether a hand can execute a grasp on a cloud: not wider than its opening, and on the object."""

import numpy as np

from foretouch.errors import GraspError
from foretouch.types import Float32, Float64, Grasp

_SAMPLE = 64  # every 64th point is searched first: it is mostly near enough


def check_reach(grasp: Grasp, cloud_xyz: Float32 | Float64, max_width_m: float, max_distance_m: float) -> None:
    """Refuse a grasp that is wider than a hand or far from its object.

    The distance is that of the contact which is nearer to the cloud: the other one may be on the hidden side.

    Args:
        grasp: In the cloud's frame.
        cloud_xyz: (..., 3) floating, points of the object [m]; points that are not finite are ignored. A cloud without a
            finite point refuses every grasp.
        max_width_m: Greatest distance between the contacts [m].
        max_distance_m: Greatest distance between the nearer contact and its nearest point [m].

    Raises:
        GraspError: With the value and the limit.
    """
    with np.errstate(over="ignore"):
        width = _length(grasp.g2 - grasp.g1)
    if not width <= max_width_m:
        raise GraspError(f"g1, g2: {width:.4g} m apart, which is above max_width_m, {max_width_m:g} m")
    points = cloud_xyz.reshape(-1, 3)
    contacts = (grasp.g1, grasp.g2)
    if any(_distance(points[::_SAMPLE], contact) <= max_distance_m for contact in contacts):
        return
    distance = min(_distance(points, contact) for contact in contacts)
    if not distance <= max_distance_m:
        raise GraspError(
            f"g1, g2: {distance:.4g} m from the nearest point of the cloud, which is above max_distance_m, "
            f"{max_distance_m:g} m"
        )


def _length(vector: Float64) -> float:
    """Euclidean length without overflow."""
    scale = float(np.abs(vector).max())
    return scale * float(np.linalg.norm(vector / scale)) if 0.0 < scale < np.inf else scale


def _distance(points: Float32 | Float64, contact: Float64) -> float:
    """Distance of the nearest finite point; infinite without one, or where the square overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.square(points - contact).sum(axis=1)
    return float(np.sqrt(np.nanmin(squares, initial=np.inf)))
