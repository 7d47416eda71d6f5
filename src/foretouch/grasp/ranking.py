# SPDX-License-Identifier: Apache-2.0
"""Contact candidates and their ranking, after GeoGrasp (Zapata-Impata et al. 2019) and its public code.

Candidates are the surface points around the two initial points of the grasp plane. Comparisons that decide whether a
point belongs are made in float32 where the original does, since points do lie on the limits.

Symbols of the two rankings: a, b candidates of the first and the second side; p1, p2 the initial points; cd distance to
the centroid, pd distance to the grasp plane, k curvature, each scaled to the range of its side; w distance of
the initial points.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from foretouch.cloud.geometry.pcl_filters import cell_means, normals_and_curvature, voxel_grid
from foretouch.errors import CloudError
from foretouch.grasp.config import SEARCH_VOXELS, GeoGraspConfig
from foretouch.types import Float32, Float64, Int64

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


def contact_sides(xyz: Float32, plane: GraspPlane, config: GeoGraspConfig) -> tuple[ContactSide, ContactSide]:
    """Find the contact candidates: the surface around each initial point, averaged in voxels.

    Args:
        xyz: (N, 3) float32 [m], filtered points.
        plane: The grasp plane with the initial points.
        config: Settings.
    """
    radius = _contact_radius(plane.width_m, config)
    return _contact_side(xyz, plane.first, radius, config), _contact_side(xyz, plane.second, radius, config)


def _contact_radius(width_m: float, config: GeoGraspConfig) -> float:
    """Return the radius around each initial point in which contacts are searched [m]; the two spheres do not overlap."""
    full = SEARCH_VOXELS * config.voxel_m
    return _OVERLAP_FRACTION * width_m if 2.0 * full >= width_m else full


def _contact_side(xyz: Float32, initial: int, radius_m: float, config: GeoGraspConfig) -> ContactSide:
    """Return the candidates strictly within a radius of the point with the index `initial`."""
    x, y, z = np.ascontiguousarray(xyz.T) - xyz[initial, :, None]
    near = np.flatnonzero(x * x + y * y + z * z < np.float32(radius_m) * np.float32(radius_m))
    normal, curvature = normals_and_curvature(xyz, near, config.normal_radius_m)
    grid = voxel_grid(xyz[near], config.voxel_m)
    # A point without a normal leaves its voxel without one: NaN propagates through the sums.
    mean = cell_means(np.column_stack([xyz[near].astype(np.float64), normal, curvature]), grid)
    length = np.linalg.norm(mean[:, 3:6], axis=1, keepdims=True)
    length[length == 0.0] = np.nan  # opposite normals cancel: the voxel has none
    own = near == initial
    candidates = SurfacePoints(mean[:, :3], mean[:, 3:6] / length, mean[:, 6])
    point = SurfacePoints(xyz[near][own].astype(np.float64), normal[own], curvature[own])
    return ContactSide(candidates, point, len(near))


_EPSILON = 1e-8  # added by the original against division by zero
_FLOAT32_MIN = 1.17549435e-38  # at which the original's search for the maximum starts
_TOLERANCE = 0.98  # of the limits that apply to the second contact
_FREE_COSINE = 0.2  # between grasp and object axis, without penalty
_ALIGNMENT_WEIGHT = 10.0
_FIRST_WEIGHT = 1.5
_MIN_RANK = 1.0  # of either ranking


class _ScaledSide:
    """The candidates of one side, and the scales of their three quantities."""

    def __init__(self, points: SurfacePoints, grasp_plane: GraspPlane, centroid: Float64) -> None:
        self._grasp_plane, self._centroid = grasp_plane, centroid
        self.limits = [_limits(values) for values in self._quantities(points)]
        self.xyz, self.normal = points.xyz, points.normal
        self.cd, self.pd, self.k = self(points)

    def __call__(self, points: SurfacePoints) -> list[Float64]:
        """cd, pd and k of any points, in the scales of this side."""
        pairs = zip(self._quantities(points), self.limits, strict=True)
        return [_scaled(values, low, high) for values, (low, high) in pairs]

    def _quantities(self, points: SurfacePoints) -> tuple[Float64, Float64, Float64]:
        return lengths(points.xyz - self._centroid), _plane_distance(points.xyz, self._grasp_plane), points.curvature


def _plane_distance(xyz: Float64, plane: GraspPlane) -> Float64:
    return np.asarray(np.abs((xyz - plane.origin) @ plane.normal), np.float64)


def _limits(values: Float64) -> tuple[float, float]:
    """Smallest and largest value over the candidates of one side, which become 0 and 1."""
    known = values[~np.isnan(values)]
    return (float(known.min()), max(float(known.max()), _FLOAT32_MIN)) if len(known) else (np.inf, np.inf)


def _scaled(values: Float64, low: float, high: float) -> Float64:
    """NaN, which never passes, where the original divides by zero."""
    if not high - low > 0.0:
        return np.full(values.shape, np.nan)
    return np.asarray((values + _EPSILON - low) / (high - low), np.float64)


def rank_pairs(
    sides: tuple[ContactSide, ContactSide], grasp_plane: GraspPlane, centroid: Float64
) -> tuple[Int64, Int64, Float64, dict[str, int]]:
    """Return all pairs of candidates that pass GeoGrasp's filters, best first; ties keep their order (a outer, b inner).

    Args:
        sides: The first and the second side.
        grasp_plane: The grasp plane.
        centroid: (3,) float64 [m], of the object.

    Returns:
        (P,) indices of a and of b, (P,) finite scores, and the number of pairs: all, dropped by each filter, and ranked.
    """
    a, b = (_ScaledSide(side.candidates, grasp_plane, centroid) for side in sides)
    p1, p2 = (side.initial for side in sides)
    w = grasp_plane.width_m
    # No contact may be deeper in the object than its initial point, nor closer to the opposite one.
    skip_a = (a.cd < a(p1)[0]) | (lengths(a.xyz - p2.xyz[0]) < w)
    skip_b = b.cd < _TOLERANCE * b(p2)[0]
    skip_b |= lengths(b.xyz - p1.xyz[0]) < _TOLERANCE * w
    apart = b.xyz[None] - a.xyz[:, None]
    distance = lengths(apart)
    kept = ~skip_a[:, None] & ~skip_b[None] & ~(distance < _TOLERANCE * w)
    i, j = np.nonzero(kept)
    r1, r2 = _two_rankings(
        apart[i, j] / distance[i, j, None],
        grasp_plane.normal,
        (a.normal[i], b.normal[j]),
        (a.pd[i], b.pd[j]),
        (a.k[i], b.k[j]),
    )
    passed = (r1 >= _MIN_RANK) & (r2 >= _MIN_RANK)  # a NaN passes nothing
    score = _FIRST_WEIGHT * r1[passed] + r2[passed]
    order = np.argsort(-score, kind="stable")
    counts = {
        "n_pairs": int(kept.size),
        "n_pairs_inside": int(kept.size - np.count_nonzero(kept)),
        "n_pairs_unknown": int(np.count_nonzero(np.isnan(r1) | np.isnan(r2))),
        "n_pairs_low": int(np.count_nonzero((r1 < _MIN_RANK) | (r2 < _MIN_RANK))),
        "n_pairs_ranked": len(order),
    }
    return i[passed][order], j[passed][order], score[order], counts


def initial_score(
    sides: tuple[ContactSide, ContactSide], grasp_plane: GraspPlane, centroid: Float64
) -> tuple[float, str]:
    """Compute the score of the initial points as a grasp, in the scales of the candidates and without thresholds.

    The score of the original may be NaN, infinite or of the order of 1e30 if a side has one candidate or all its
    candidates are alike. Such a score is meaningless and replaced by NaN.

    Returns:
        The score and "", or NaN and the reason.
    """
    first, second = (_ScaledSide(side.candidates, grasp_plane, centroid) for side in sides)
    p1, p2 = (side.initial for side in sides)
    for name, side, initial in (("first", first, p1), ("second", second, p2)):
        if not np.isfinite(initial.curvature[0]):
            return float("nan"), f"no score: the {name} initial point has fewer than 3 points around it and no normal"
        if not all(high - low > _EPSILON for low, high in side.limits[1:]):  # epsilon would determine the result
            return float("nan"), f"no score: the candidates of the {name} side do not differ ({len(side.xyz)} of them)"
    _, pd1, k1 = first(p1)
    _, pd2, k2 = second(p2)
    unit = (p2.xyz - p1.xyz) / grasp_plane.width_m
    r1, r2 = _two_rankings(unit, grasp_plane.normal, (p1.normal, p2.normal), (pd1, pd2), (k1, k2))
    return float(_FIRST_WEIGHT * r1[0] + r2[0]), ""


def _two_rankings(
    unit: Float64,
    axis: Float64,
    normals: tuple[Float64, Float64],
    pd: tuple[Float64, Float64],
    k: tuple[Float64, Float64],
) -> tuple[Float64, Float64]:
    """R1 (close to the plane, across the axis) and R2 (flat, facing each other) of P pairs; `unit` is unit(b - a)."""
    aligned = np.abs(unit @ axis) + _EPSILON - _FREE_COSINE
    c_a, c_b = (np.abs(np.einsum("ij,ij->i", unit, normal)) + _EPSILON for normal in normals)
    r1 = 2.0 - pd[0] - pd[1] - _ALIGNMENT_WEIGHT * aligned
    return r1, 2.0 - k[0] - k[1] + c_a + c_b - np.abs(c_a - c_b)


def lengths(vectors: Float64) -> Float64:
    """Return (...,) float64 lengths of vectors (..., 3)."""
    return np.asarray(np.sqrt(np.einsum("...i,...i", vectors, vectors)), np.float64)
