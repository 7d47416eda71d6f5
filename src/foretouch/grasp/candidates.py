# SPDX-License-Identifier: Apache-2.0
"""Contact candidates: the grasp plane with its two initial points, and the surface points around them.

After GeoGrasp (Zapata-Impata et al. 2019) and its public code. Comparisons that decide whether a point
belongs are made in float32 where the original does, since points do lie on the limits.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.pcl_filters import normals_and_curvature, voxel_grid
from foretouch.errors import CloudError
from foretouch.grasp.config import GeoGraspConfig
from foretouch.types import Float32, Float64

_OVERLAP_FRACTION = 0.35  # of the width: radius of the two spheres where two full ones would overlap


@dataclass(frozen=True, eq=False)
class GraspPlane:
    """The plane across the object's axis, and the initial points: the extremes of the object near it."""

    origin: Float64  # (3,) float64 [m], a point of the plane
    normal: Float64  # (3,) float64, the object's axis
    first: int  # index of the initial point with the minimum coordinate
    second: int  # index of the initial point with the maximum coordinate
    n_points: int  # number of points near the plane
    width_m: float  # distance of the initial points [m]

    def distance(self, points: npt.NDArray[np.floating]) -> Float64:
        """(N,) float64: distance of (N, 3) points from the plane [m], not negative."""
        return np.asarray(np.abs((points - self.origin) @ self.normal), np.float64)


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points of the object's surface with normals: single points, or averages of voxels."""

    xyz: Float64  # (M, 3) float64 [m]
    normal: Float64  # (M, 3) float64, unit length; NaN where unknown
    curvature: Float64  # (M,) float64; NaN where unknown


class ContactSide(NamedTuple):
    """The contact candidates on one side of the object."""

    candidates: SurfacePoints  # in the order of their voxels
    initial: SurfacePoints  # the initial point alone, with its own normal and curvature
    n_points: int  # points that the candidates average


def find_grasp_plane(xyz: Float32, centre: Float64, axis: Float64, side: int, half_width_m: float) -> GraspPlane:
    """Find the initial points: the extremes of one coordinate among the points near the grasp plane.

    Args:
        xyz: (N, 3) float32 [m], the filtered cloud at full resolution.
        centre: (3,) float64 [m], a point of the grasp plane.
        axis: (3,) float64, its normal, unit length.
        side: The coordinate whose extremes are the initial points: 0, 1 or 2.
        half_width_m: Only points strictly closer to the plane are considered [m].

    Raises:
        CloudError: If no point is near the plane, or all of them coincide.
    """
    along = (xyz.astype(np.float64) - centre) @ axis
    inside = np.flatnonzero(np.abs(along) < half_width_m)
    if len(inside) == 0:
        raise CloudError(
            f"no point within {half_width_m * 1e3:g} mm of the grasp plane; "
            f"from it the object spans {along.min():.3f} ... {along.max():.3f} m along its axis"
        )
    # Of equal extremes, the first in the order of the cloud.
    first, second = (int(inside[pick(xyz[inside, side])]) for pick in (np.argmin, np.argmax))
    width = float(np.linalg.norm(xyz[first].astype(np.float64) - xyz[second]))
    if width == 0.0:
        raise CloudError(f"the {len(inside)} points near the grasp plane leave no two contacts")
    return GraspPlane(centre, axis, first, second, len(inside), width)


def contact_radius(width_m: float, config: GeoGraspConfig) -> float:
    """Radius around each initial point in which contacts are searched [m]; the two spheres do not overlap."""
    full = config.contact_radius_m
    return _OVERLAP_FRACTION * width_m if 2.0 * full >= width_m else full


def contact_side(xyz: Float32, initial: int, radius_m: float, config: GeoGraspConfig) -> ContactSide:
    """Contact candidates: the surface around one initial point, averaged in voxels.

    Args:
        xyz: (N, 3) float32 [m], the filtered cloud.
        initial: Index of the initial point.
        radius_m: Points strictly within are candidates [m].
        config: Settings.
    """
    x, y, z = np.ascontiguousarray(xyz.T) - xyz[initial, :, None]
    near = np.flatnonzero(x * x + y * y + z * z < np.float32(radius_m) * np.float32(radius_m))
    normal, curvature = normals_and_curvature(xyz, near, config.normal_radius_m)
    grid = voxel_grid(xyz[near], config.voxel_m)
    # A point without a normal leaves its voxel without one: NaN propagates through the sums.
    mean = grid.mean(np.column_stack([xyz[near].astype(np.float64), normal, curvature]))
    length = np.linalg.norm(mean[:, 3:6], axis=1, keepdims=True)
    length[length == 0.0] = np.nan  # opposite normals cancel: the voxel has none
    own = near == initial
    candidates = SurfacePoints(mean[:, :3], mean[:, 3:6] / length, mean[:, 6])
    point = SurfacePoints(xyz[near][own].astype(np.float64), normal[own], curvature[own])
    return ContactSide(candidates, point, len(near))
