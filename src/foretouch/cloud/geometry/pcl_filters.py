# SPDX-License-Identifier: Apache-2.0
"""PCL's VoxelGrid, NormalEstimation and StatisticalOutlierRemoval, as GeoGrasp uses them.

Comparisons and sums that decide on single points are made in float32, as in PCL.
"""

import numpy as np

from foretouch.errors import CloudError
from foretouch.kernels import Kernel
from foretouch.types import Bool, Float32, Float64, Floating, Int64, Integer

_mean_neighbour_distance = Kernel("mean_neighbour_distance")
_moments_within = Kernel("summed_moments")
_fit_planes = Kernel("fit_planes")
_voxel_cells = Kernel("voxel_cells")
_cell_means = Kernel("cell_means")

_CUBE = 0.57  # radii: edge of a cube whose diagonal is shorter than the radius
_MARGIN = 1.001  # radii: far more than float32 rounding
_LINE = 1e-8  # middle over major eigenvalue, below which the neighbours lie on a line up to float32 rounding


Voxels = tuple[Int64, Int64]
"""(N,) int64 cell of each point, 0 ... M - 1, cells ordered x fastest, then y, then z; and (M,) int64 points of each, at least 1."""


def cell_means(values: Floating, voxels: Voxels) -> Float64:
    """Return (M, C) float64 means of (N, C) values over the points of each cell; a NaN propagates within its column."""
    cell, counts = voxels
    means = np.empty((len(counts), values.shape[1]))
    values = np.ascontiguousarray(values, np.float64)
    _cell_means(values, *values.shape, cell, counts, len(counts), means)
    return means


def voxel_grid(xyz: Float32, leaf_m: float) -> Voxels:
    """Assign points to cubes whose corners are multiples of the edge, regardless of the cloud's extent.

    The cell is floor(x · (1/leaf)) in float32, as in PCL: points on a face would otherwise change sides.

    Args:
        xyz: (N, 3) float32 [m], finite. N may be 0.
        leaf_m: Edge of a cube [m].

    Raises:
        CloudError: If the cloud spans too many cells.
    """
    if len(xyz) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    per_m = np.float32(1.0) / np.float32(leaf_m)
    cell = np.empty(len(xyz), np.int64)
    counts = np.empty(len(xyz), np.int64)
    cell_count = np.empty(1, np.int64)
    _voxel_cells(np.ascontiguousarray(xyz), len(xyz), float(per_m), cell, counts, cell_count)
    if cell_count[0] >= 0:
        return cell, counts[: cell_count[0]].copy()
    # The grid is too wide for a table of its cells.
    ijk = np.floor(np.ascontiguousarray(xyz.T) * per_m).astype(np.float64)
    ijk -= ijk.min(axis=1, keepdims=True)
    size = ijk.max(axis=1) + 1.0
    if not np.prod(size) < 2.0**62:
        raise CloudError(f"xyz: spans {size.tolist()} cells of {leaf_m} m, too many to number")
    i, j, k = ijk.astype(np.int64)
    _, cell, counts = np.unique(i + int(size[0]) * (j + int(size[1]) * k), return_inverse=True, return_counts=True)
    return cell.reshape(-1), counts


def normals_and_curvature(xyz: Float32, query: Integer, radius_m: float = 0.03) -> tuple[Float64, Float64]:
    """Return normals and curvature of chosen points, by fitting a plane to the neighbours of each.

    Neighbours, including the point itself, are strictly closer than the radius. The normal is the minor eigenvector of
    their covariance, oriented towards the sensor at the origin; curvature is the smallest eigenvalue over their sum.

    Args:
        xyz: (N, 3) float32 [m], finite.
        query: (Q,) integer, indices of the chosen points. Q may be 0.
        radius_m: Radius of the neighbourhood [m].

    Returns:
        (Q, 3) float64 unit normals and (Q,) float64 curvature in 0 ... 1/3; NaN in both where the
        neighbours are fewer than three or collinear.
    """
    if len(query) == 0:
        return np.zeros((0, 3)), np.zeros(0)
    points = xyz[query]
    sums = _summed_moments(xyz[_in_box(xyz, points, radius_m)], points, radius_m)
    normals, curvature = np.empty((len(sums), 3)), np.empty(len(sums))
    _fit_planes(sums, points, len(sums), _LINE, normals, curvature)
    return normals, curvature


def count_without_normal(xyz: Float32, radius_m: float = 0.03) -> int:
    """Return the number of points (N, 3), finite, for which `normals_and_curvature` would find no normal; N may be 0."""
    if len(xyz) == 0:
        return 0
    # All points in a small cube are neighbours of each other: if they span a plane, so do the neighbours of each.
    cell, counts = voxels = voxel_grid(xyz, radius_m * _CUBE)
    offset = xyz.astype(np.float64) - xyz[0]
    mean = cell_means(np.column_stack([offset, (offset[:, :, None] * offset[:, None]).reshape(-1, 9)]), voxels)
    covariance = mean[:, 3:].reshape(-1, 3, 3) - mean[:, :3, None] * mean[:, None, :3]
    trace = np.trace(covariance, axis1=1, axis2=2)
    # Sum of the products of two eigenvalues: zero on a line, where only one eigenvalue is not zero.
    products = (trace * trace - np.einsum("qij,qij->q", covariance, covariance)) / 2.0
    spans_plane = (counts >= 3) & (products > _LINE * trace * trace)
    undecided = np.flatnonzero(~spans_plane[cell])
    return int(np.count_nonzero(np.isnan(normals_and_curvature(xyz, undecided, radius_m)[1])))


def _in_box(xyz: Float32, around: Float32, radius_m: float) -> Bool:
    """Return points that can be neighbours of any of `around`, by bounding box."""
    margin = np.float32(radius_m * _MARGIN)
    inside: Bool = np.ones(len(xyz), np.bool_)
    for column, middle in zip(np.ascontiguousarray(xyz.T), around.T, strict=True):
        inside &= column >= middle.min() - margin
        inside &= column <= middle.max() + margin
    return inside


def _summed_moments(near: Float32, points: Float32, radius_m: float) -> Float64:
    """Return (Q, 10) float64: sums of the moments of each point's neighbours among `near`."""
    sums = np.empty((len(points), 10))
    _moments_within(near, len(near), points, len(points), float(np.float32(radius_m) ** 2), near[0], sums)
    if sums[0, 0] < 0.0:
        raise MemoryError("summed_moments")
    return sums


def inlier_mask(xyz: Float32, neighbours: int = 50, deviations: float = 1.0) -> Bool:
    """Return (N,) bool, inliers of statistical outlier removal: mean neighbour distance <= mean + deviations · std over the cloud.

    The standard deviation is divided by n - 1. A single point is an inlier.

    Args:
        xyz: (N, 3) float32 [m], finite. N may be 0.
        neighbours: As `k` of `mean_neighbour_distance`.
        deviations: Standard deviations above the mean that are still kept.
    """
    if len(xyz) < 2:
        return np.ones(len(xyz), np.bool_)
    distance = mean_neighbour_distance(xyz, neighbours).astype(np.float64)
    return np.asarray(distance <= distance.mean() + deviations * distance.std(ddof=1))


def mean_neighbour_distance(xyz: Float32, k: int) -> Float32:
    """Return (N,) float32 [m]: mean distance from each of (N, 3) finite points to its k nearest neighbours, excluding itself.

    All other points if there are fewer; zero for a single point.
    """
    k = min(k, len(xyz) - 1)
    if k < 1:
        return np.zeros(len(xyz), np.float32)
    result, proven = np.empty(len(xyz), np.float32), np.empty(len(xyz), np.uint8)
    _mean_neighbour_distance(np.ascontiguousarray(xyz), len(xyz), k, result, proven)
    pending = np.flatnonzero(proven == 0)
    if len(pending):
        result[pending] = _tree_mean_distance(xyz, pending, k)
    return result


def _tree_mean_distance(xyz: Float32, query: Int64, k: int) -> Float32:
    """Measure the points that the compiled search gives up: in a pile of thousands, or so far away that squares overflow."""
    from scipy.spatial import cKDTree

    index = cKDTree(xyz).query(xyz[query], k + 1)[1]
    squared = np.zeros(index.shape, np.float32)
    for column in np.ascontiguousarray(xyz.T):  # in float32, as in the compiled search: equal distances round equally
        difference = column.take(index)
        difference -= column[query, None]
        difference *= difference
        squared += difference
    return np.asarray(np.sqrt(squared).sum(axis=1, dtype=np.float64) / k, np.float32)
