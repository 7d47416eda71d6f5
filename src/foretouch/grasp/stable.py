# SPDX-License-Identifier: Apache-2.0
"""The stable variant of GeoGrasp: the same idea, with no decision that a small change of the cloud can flip.

GeoGrasp (Zapata-Impata et al. 2019) decides by hard limits: a point is an outlier or not, belongs to a voxel of a grid
that is anchored at the sensor, is the extreme of the grasp plane, or ranks first. Here every such limit is a weight
between 0 and 1, all directions are those of the object and its table, and sums do not depend on the order of the
points:

- outliers fade out around the limit of the filter; points weigh by the area that they cover, instead of voxels;
- the sign of the axis is that of the object's own asymmetry;
- the initial points are weighted means of the points near the two extremes of the grasp plane;
- candidates are the nodes of a grid anchored at the initial points, each the mean of the points around it with tent
  weights, which add up to one for each point;
- the grasp is the mean of the pairs of candidates, weighted by score; each contact is moved outwards, to the mean of the
  outermost points around the line through both.

A rigid motion of object and table therefore moves the grasp along. Only where the object is too round or too symmetric
to have an axis or a sign of its own, one direction of the camera's frame decides.
"""

from dataclasses import dataclass

import numpy as np

from foretouch.errors import CloudError
from foretouch.grasp.config import SEARCH_VOXELS, GeoGraspConfig
from foretouch.grasp.hold import HeldGrasp
from foretouch.grasp.pose import cross
from foretouch.grasp.ranking import ALIGNMENT_WEIGHT, FIRST_WEIGHT, FREE_COSINE, MIN_RANK, OVERLAP_FRACTION, lengths
from foretouch.kernels import Kernel
from foretouch.types import Bool, Float32, Float64, Floating, Plane

_tent_sums = Kernel(
    "tent_sums",
    *(np.float64, np.float64, int, np.float64, np.float64),
    *(float, float, float, int, np.float64, np.int64),
)
_planes_at = Kernel("local_planes", np.float64, np.float64, int, np.float64, int, float, np.float64, np.float64)
_surface_mean = Kernel("surface_mean", np.float64, np.float64, int, np.float64, float, np.float64)
_MOST_NODES = 4096  # a grid of twice the search radius has about 1000

_ISOLATED = 20.0  # medians of the distance to the neighbours beyond which a point is isolated; recorded ones reach 10
_FADE = 0.25  # standard deviations on either side of the outlier limit, over which points fade out
_UPRIGHT = (0.45, 0.65)  # |axis · table normal| over which the sides turn from across the table to across the view
_EXTREME_M = 0.001  # depth over which points count as extreme [m]
_TEMPERATURE = 0.25  # of the score, in which the weight of a pair falls by a factor of e
_INSIDE_M = 0.0005  # depth over which a contact inside its initial point loses its weight [m]
_BESIDE_M = 0.002  # from the line through both contacts, over which points count for a contact [m]
_OUTSIDE_M = 0.012  # from a contact along that line is the place whose nearest points count: the outermost 0.3 mm [m]
_INITIAL_WEIGHT = 0.05  # of the pair of initial points, beside the pairs of candidates
_FULL_CELL = 4.0  # points in a cell, from which on their number does not count
_EPSILON = 1e-9  # floor of a divisor
# What an object without a main axis or without asymmetry leaves open follows one direction of the camera's frame.
_PREFERRED = np.array([0.95, 0.3, 0.08])  # mostly the image's x; of length 1 within 0.1 %
_AXIS_BIAS = 0.01  # of the major eigenvalue, added along it
_AXIS_NOISE = 0.05  # of the major eigenvalue: what the noise of a depth camera 1.25 m away changes it by
_SIGN_BIAS = 0.01  # of the normalised third moment; 0.1 mm of noise on a recorded cloud changes it by 0.002


@dataclass(frozen=True, eq=False)
class WeightedPoints:
    """The points of an object with their weights."""

    xyz: Float64  # (N, 3) float64 [m]
    inlier: Float64  # (N,) float64, 0 for an outlier ... 1
    area: Float64  # (N,) float64, proportional to the surface that each point covers, 0 for an outlier
    n_isolated: int  # points far from all others


@dataclass(frozen=True, eq=False)
class ObjectFrame:
    """The object's own frame."""

    centroid: Float64  # (3,) float64 [m], of the visible surface
    axis: Float64  # (3,) float64, the object's main axis
    across: Float64  # (3,) float64, from the first to the second side, perpendicular to the axis
    ratio: float  # middle over major eigenvalue, 0 ... 1
    covariance: Float64  # (3, 3) float64 [m²], of the visible surface


@dataclass(frozen=True, eq=False)
class StableSide:
    """The candidates of one side; the first is its initial point."""

    xyz: Float64  # (M, 3) float64 [m]
    mass: Float64  # (M,) float64, 0 ... 1: how well the candidate is supported by points
    normal: Float64  # (M, 3) float64, unit length, of any sign
    curvature: Float64  # (M,) float64, 0 ... 1/3
    n_points: int  # points within the radius


@dataclass(frozen=True, eq=False)
class _StablePairs:
    """All pairs of candidates with their scores; row and column 0 are those of the initial points."""

    score: Float64  # (A, B) float64
    passes: Bool  # (A, B) bool, both rankings reach their minimum
    contacts: Float64  # (2, 3) float64 [m], the weighted mean of the pairs, each moved outwards to the outline


def _smoothstep(values: Floating, low: float, high: float) -> Float64:
    """0 below `low`, 1 above `high`, with a continuous slope between."""
    t = np.clip((np.asarray(values, np.float64) - low) / max(high - low, 1e-300), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), np.float64)


def weigh_points(xyz: Float32, neighbour_distance: Float32, config: GeoGraspConfig) -> WeightedPoints:
    """Weights of the points by their mean distance to their neighbours.

    Isolated points do not count at all, since a single one far away would move the outlier limit for all others.

    Args:
        xyz: (N, 3) float32 [m], finite, in an order that does not depend on the input's.
        neighbour_distance: (N,) float32 [m], see `mean_neighbour_distance`.
        config: Settings.
    """
    d = neighbour_distance.astype(np.float64)
    isolated = d > _ISOLATED * max(float(np.median(d)), _EPSILON)
    near = d[~isolated] if isolated.any() else d
    spread = float(near.std(ddof=1)) if len(near) > 1 else 0.0
    limit = float(near.mean()) + config.outlier_deviations * spread
    fade = _FADE * spread + 1e-9
    inlier = np.where(isolated, 0.0, 1.0 - _smoothstep(d, limit - fade, limit + fade))
    return WeightedPoints(xyz.astype(np.float64, order="C"), inlier, inlier * d * d, int(np.count_nonzero(isolated)))


def object_frame(points: WeightedPoints, plane: Plane) -> ObjectFrame:
    """Centroid, main axis and the direction across it; the signs follow the object's asymmetry.

    `across` is the table's normal x the axis, and for an upright object the axis x the direction of view; it changes
    its sign with the axis. Of the two signs, that with the larger sum of the third moments along both directions is
    taken. A small constant preference for one direction of the camera's frame is added to the second and the third
    moments: it decides where the object is as round, or as symmetric, as the noise.

    Raises:
        CloudError: If the points coincide.
    """
    total = float(points.area.sum())
    if not total > 0.0:
        raise CloudError(f"xyz: {len(points.xyz)} points at one place have no axis")
    centroid = points.area @ points.xyz / total
    offset = points.xyz - centroid
    covariance = (offset * points.area[:, None]).T @ offset / total
    largest = float(np.linalg.eigvalsh(covariance)[2])
    values, vectors = np.linalg.eigh(covariance + _AXIS_BIAS * largest * np.outer(_PREFERRED, _PREFERRED))
    axis = vectors[:, 2]
    up = np.asarray(plane.normal, np.float64)
    if up @ centroid > 0.0:
        up = -up
    lying = cross(up, axis)
    upright = cross(axis, centroid / max(float(np.linalg.norm(centroid)), _EPSILON))
    share = float(_smoothstep(np.array(abs(up @ axis)), *_UPRIGHT))
    across = (1.0 - share) * lying + share * upright
    if np.linalg.norm(across) < 1e-6:
        across = vectors[:, 1]
    across -= (across @ axis) * axis
    across /= np.linalg.norm(across)
    weight = points.area / total
    skew = sum(_third_moment(weight, along) for along in (offset @ axis, offset @ across))
    if skew + _SIGN_BIAS * (across @ _PREFERRED) < 0.0:
        axis, across = -axis, -across
    return ObjectFrame(centroid, axis, across, float(max(values[1], 0.0) / values[2]), covariance)


def _third_moment(weight: Float64, along: Float64) -> float:
    """Skewness of weighted coordinates with mean zero."""
    squared = along * along
    return float((weight * squared) @ along / max(float(weight @ squared), 1e-300) ** 1.5)


def soft_extremes(
    points: WeightedPoints, frame: ObjectFrame, slide_m: float, half_width_m: float
) -> tuple[Float64, int]:
    """The initial points: weighted means of the points near the two extremes of the grasp plane.

    Returns:
        (2, 3) float64 [m], first and second; and the number of points near the plane.

    Raises:
        CloudError: If no point is near the plane, or the two coincide.
    """
    offset = points.xyz - frame.centroid
    along = offset @ frame.axis
    near = np.clip(1.0 - ((along - slide_m) / (1.5 * half_width_m)) ** 2, 0.0, None) ** 2 * points.inlier
    index = np.flatnonzero(near > 0.0)
    if len(index) == 0:
        raise CloudError(
            f"no point within {half_width_m * 1e3:g} mm of the grasp plane; "
            f"from it the object spans {along.min() - slide_m:.3f} ... {along.max() - slide_m:.3f} m along its axis"
        )
    t, near, xyz = (offset @ frame.across)[index], near[index], points.xyz[index]
    ends = []
    for sign in (-1.0, 1.0):
        weight = near * np.exp((sign * t - (sign * t).max()) / _EXTREME_M)
        ends.append(weight @ xyz / weight.sum())
    first, second = ends
    if np.linalg.norm(first - second) < 1e-6:
        raise CloudError(f"the {len(index)} points near the grasp plane leave no two contacts")
    return np.stack([first, second]), len(index)


def stable_side(
    points: WeightedPoints, initial: Float64, frame: ObjectFrame, width_m: float, config: GeoGraspConfig
) -> StableSide:
    """Candidates around one initial point, on a grid anchored at it."""
    radius = min(SEARCH_VOXELS * config.voxel_m, OVERLAP_FRACTION * width_m)
    basis = np.stack([frame.axis, frame.across, cross(frame.axis, frame.across)])
    mass, sums, n_points = _node_sums(points, initial, basis, radius, config.voxel_m)
    held = mass > 1e-6
    centres = np.concatenate([initial[None], sums[held] / mass[held, None]])
    masses = np.concatenate([[1.0], mass[held] / (mass[held] + _FULL_CELL)])
    normal, curvature = _local_planes(points, centres, config.normal_radius_m)
    return StableSide(centres, masses, normal, curvature, n_points)


def _node_sums(
    points: WeightedPoints, initial: Float64, basis: Float64, radius_m: float, voxel_m: float
) -> tuple[Float64, Float64, int]:
    """Weights of the points around an initial point at the nodes of a grid, in the order of the nodes.

    Returns:
        (M,) float64 sums of the weights, (M, 3) float64 sums of weights times places [m], and the number of points.
    """
    near_m, far_m = radius_m * 0.9, radius_m * 1.1
    nodes, found = np.empty((_MOST_NODES, 4)), np.empty(2, np.int64)
    limits = (voxel_m, near_m, far_m, _MOST_NODES)
    _tent_sums(points.xyz, points.inlier, len(points.xyz), initial, basis, *limits, nodes, found)
    n_points, size = found.tolist()
    if size < 0:
        raise MemoryError("tent_sums")
    return nodes[:size, 0], nodes[:size, 1:], n_points


def _local_planes(points: WeightedPoints, centres: Float64, radius_m: float) -> tuple[Float64, Float64]:
    """Normal and curvature of the surface around some places; points fade out towards the radius.

    Returns:
        (M, 3) float64 unit normals of any sign, and (M,) float64 curvature, 0 ... 1/3.
    """
    normals, curvature = np.empty((len(centres), 3)), np.empty(len(centres))
    _planes_at(points.xyz, points.inlier, len(points.xyz), centres, len(centres), radius_m, normals, curvature)
    return normals, curvature


class StableRanking:
    """GeoGrasp's two rankings, with the scales of the candidates of one object.

    Args:
        points: Of the object.
        sides: Their candidates.
        frame: The object's frame.
        slide_m: Shift of the grasp plane along the axis [m].
        normal_radius_m: Radius of the neighbourhood for normals [m].
    """

    def __init__(
        self,
        points: WeightedPoints,
        sides: tuple[StableSide, StableSide],
        frame: ObjectFrame,
        slide_m: float,
        normal_radius_m: float,
    ) -> None:
        self._points, self._sides, self._frame = points, sides, frame
        self._slide_m = slide_m
        self._normal_radius_m = normal_radius_m
        self._largest = [
            (_soft_max(side.mass, self._plane_distance(side.xyz, frame.axis)), _soft_max(side.mass, side.curvature))
            for side in sides
        ]

    def pairs(self) -> _StablePairs:
        """Scores of all pairs of candidates, and the mean of the pairs."""
        a, b = self._sides
        width = lengths(b.xyz[0] - a.xyz[0])
        r1, r2 = self._rank(a.xyz, b.xyz, (a.normal, b.normal), (a.curvature, b.curvature))
        score = FIRST_WEIGHT * r1 + r2
        # No contact is deeper in the object than its initial point, nor closer to the opposite one.
        inside = []
        for side, other in ((a, b.xyz[0]), (b, a.xyz[0])):
            to_centroid = lengths(side.xyz - self._frame.centroid)
            inside.append(side.mass * _keep(to_centroid[0] - to_centroid) * _keep(width - lengths(side.xyz - other)))
        support = inside[0][:, None] * inside[1][None] * _keep(width - _distances(a.xyz, b.xyz))
        support[0, :] *= _INITIAL_WEIGHT
        support[:, 0] *= _INITIAL_WEIGHT
        support[0, 0] = _INITIAL_WEIGHT
        weight = support * np.exp(np.clip((score - score[0, 0]) / _TEMPERATURE, -200.0, 200.0))
        weight /= weight.sum()
        first, second = weight.sum(axis=1) @ a.xyz, weight.sum(axis=0) @ b.xyz
        outwards = _OUTSIDE_M * (second - first) / max(float(lengths(second - first)), _EPSILON)
        contacts = [_onto_surface(self._points, one) for one in (first - outwards, second + outwards)]
        return _StablePairs(score, (r1 >= MIN_RANK) & (r2 >= MIN_RANK), np.stack(contacts))

    def score(self, contacts: Float64, axis: Float64 | None = None) -> tuple[float, bool]:
        """Score of any two contacts, and whether both rankings reach their minimum.

        Args:
            contacts: (2, 3) float64 [m], on the first and the second side.
            axis: (3,) float64, of the object, in place of that of its frame.
        """
        normals, curvature = _local_planes(self._points, contacts, self._normal_radius_m)
        first, second = contacts[:1], contacts[1:]
        r1, r2 = self._rank(first, second, (normals[:1], normals[1:]), (curvature[:1], curvature[1:]), axis)
        return float(FIRST_WEIGHT * r1[0, 0] + r2[0, 0]), bool(r1[0, 0] >= MIN_RANK and r2[0, 0] >= MIN_RANK)

    def score_held(self, held: HeldGrasp) -> tuple[float, bool]:
        """`score` of a grasp of an earlier cloud, for its own axis if that is as good a one up to noise."""
        frame, first, second = self._frame, held.grasp.g1, held.grasp.g2
        moments = [float(one @ frame.covariance @ one) for one in (held.axis, frame.axis)]
        axis = held.axis if moments[0] >= (1.0 - _AXIS_NOISE) * moments[1] else frame.axis
        ends = [first, second] if (second - first) @ frame.across >= 0.0 else [second, first]
        return self.score(np.stack(ends), axis)

    def _rank(
        self,
        a: Float64,
        b: Float64,
        normals: tuple[Float64, Float64],
        curvatures: tuple[Float64, Float64],
        axis: Float64 | None = None,
    ) -> tuple[Float64, Float64]:
        """(A, B) float64 R1 and R2 of every pair of (A, 3) and (B, 3) places."""
        axis = self._frame.axis if axis is None else axis
        (pd_a, k_a), (pd_b, k_b) = (
            (self._plane_distance(xyz, axis) / largest[0], curvature / largest[1])
            for xyz, curvature, largest in zip((a, b), curvatures, self._largest, strict=True)
        )
        per_m = 1.0 / np.maximum(_distances(a, b), _EPSILON)
        a, b = a - self._frame.centroid, b - self._frame.centroid  # cosines of b - a with the axis and both normals
        aligned = np.abs((b @ axis)[None] - (a @ axis)[:, None]) * per_m
        c_a = np.abs(normals[0] @ b.T - _dot(normals[0], a)[:, None]) * per_m
        c_b = np.abs(_dot(normals[1], b)[None] - a @ normals[1].T) * per_m
        r1 = (2.0 + ALIGNMENT_WEIGHT * FREE_COSINE - pd_a)[:, None] - pd_b[None] - ALIGNMENT_WEIGHT * aligned
        return r1, (2.0 - k_a)[:, None] - k_b[None] + 2.0 * np.minimum(c_a, c_b)

    def _plane_distance(self, xyz: Float64, axis: Float64) -> Float64:
        return np.asarray(np.abs((xyz - (self._frame.centroid + self._slide_m * axis)) @ axis), np.float64)


def _soft_max(mass: Float64, values: Float64) -> float:
    """Smooth maximum of supported values: the mean weighted by their cubes."""
    weight = mass * values**3
    return max(float(weight @ values) / max(float(weight.sum()), 1e-300), _EPSILON)


def _keep(depth: Float64) -> Float64:
    """1 outside, falling to 0 with the depth inside [m]."""
    return np.asarray(1.0 / (1.0 + np.exp(np.clip(depth / _INSIDE_M, -40.0, 40.0))), np.float64)


def _dot(a: Float64, b: Float64) -> Float64:
    return np.asarray(np.einsum("ij,ij->i", a, b), np.float64)


def _distances(a: Float64, b: Float64) -> Float64:
    """(A, B) float64 distances of (A, 3) and (B, 3) places."""
    from scipy.spatial.distance import cdist

    return np.asarray(cdist(a, b), np.float64)


def _onto_surface(points: WeightedPoints, place: Float64) -> Float64:
    """The mean of the points nearest to a place, with weights that fall with the distance beyond that of the nearest."""
    mean = np.empty(3)
    _surface_mean(points.xyz, points.inlier, len(points.xyz), place, _BESIDE_M, mean)
    return mean
