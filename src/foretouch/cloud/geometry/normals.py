# SPDX-License-Identifier: Apache-2.0
"""Normals and curvature of chosen points, after PCL's NormalEstimation as GeoGrasp uses it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.voxel import VoxelGrid, voxel_grid
from foretouch.types import Float32, Float64

__all__ = ["count_without_normal", "normals_and_curvature"]

_BLOCK_PAIRS = 60_000  # of query and neighbour at a time: they fit the cache, and OpenBLAS its small-matrix kernel
_CUBE = 0.57  # radii: the edge of a cube whose diagonal is shorter than the radius
_SAMPLE_STEP = 8
_MARGIN = 1.001  # radii: far more than float32 rounds away
_FEWEST = 3  # points that span a plane
_LINE = 1e-8  # middle over major eigenvalue, below which the neighbours lie on a line but for float32 rounding


def normals_and_curvature(
    xyz: Float32, query: npt.NDArray[np.integer], radius_m: float = 0.03
) -> tuple[Float64, Float64]:
    """Fit a plane to all points around each chosen one.

    Neighbours, the point itself among them, are strictly closer than the radius, compared in float32 as
    PCL does. The normal is the minor eigenvector of their covariance, turned towards the sensor
    at the origin; curvature is the least eigenvalue over their sum. Neighbours on one line have no normal.

    Args:
        xyz: (N, 3) float32 [m], finite.
        query: (Q,) integer, indices of the points to answer for. Q may be 0.
        radius_m: Radius of the neighbourhood [m].

    Returns:
        (Q, 3) float64 unit normals and (Q,) float64 curvature in 0 ... 1/3; NaN in both where the
        neighbours are fewer than three or on one line.
    """
    if len(query) == 0:
        return np.zeros((0, 3)), np.zeros(0)
    near = xyz[_in_box(xyz, xyz[query], radius_m)]
    return _fit(_summed_moments(near, xyz[query], radius_m), xyz[query])


def count_without_normal(xyz: Float32, radius_m: float = 0.03, grid: VoxelGrid | None = None) -> int:
    """Number of points to which `normals_and_curvature` would give no normal.

    Args:
        xyz: (N, 3) float32 [m], finite. N may be 0.
        radius_m: Radius of the neighbourhood [m].
        grid: The points in voxels, if that is at hand; one of too long an edge is not used.
    """
    if len(xyz) == 0:
        return 0
    # All points of such a cube are neighbours of each other: if they span a plane, so do the neighbours of each.
    if grid is None or grid.leaf_m > radius_m * _CUBE:
        grid = voxel_grid(xyz, radius_m * _CUBE)
    spans = _spans_plane(grid.mean(_moments(xyz, xyz[0])) * grid.counts[:, None])
    doubtful = np.flatnonzero(~spans[grid.cell])
    # Some of the neighbours spanning one is enough, too; all are asked for the few points that remain.
    for step in (_SAMPLE_STEP, 1):
        if len(doubtful) == 0:
            break
        near = xyz[_in_box(xyz, xyz[doubtful], radius_m)][::step]
        doubtful = doubtful[~_spans_plane(_summed_moments(near, xyz[doubtful], radius_m))]
    return len(doubtful)


def _in_box(xyz: Float32, around: Float32, radius_m: float) -> npt.NDArray[np.bool_]:
    """The points that can be neighbours of any of `around`."""
    margin = np.float32(radius_m * _MARGIN)
    inside: npt.NDArray[np.bool_] = np.ones(len(xyz), np.bool_)
    for column, middle in zip(np.ascontiguousarray(xyz.T), around.T, strict=True):
        inside &= column >= middle.min() - margin
        inside &= column <= middle.max() + margin
    return inside


def _summed_moments(near: Float32, points: Float32, radius_m: float) -> Float64:
    """(Q, 10) float64: the moments of each point's neighbours among `near`, summed."""
    moments = _moments(near, near[0])
    limit = np.float32(radius_m) * np.float32(radius_m)
    columns = np.ascontiguousarray(near.T)
    sums = np.empty((len(points), moments.shape[1]))
    rows = max(1, _BLOCK_PAIRS // len(near))
    for start in range(0, len(points), rows):
        squared = _squared_distances(columns, points[start : start + rows])
        sums[start : start + rows] = (squared < limit).astype(np.float64) @ moments
    return sums


def _squared_distances(columns: Float32, points: Float32) -> Float32:
    """(Q, M) float32 [m²] from (3, M) and (Q, 3); x, y, z are summed in this order, as PCL does."""
    total = columns[0] - points[:, 0, None]
    total *= total
    for axis in (1, 2):
        square = columns[axis] - points[:, axis, None]
        square *= square
        total += square
    return np.asarray(total, np.float32)


def _moments(xyz: Float32, origin: Float32) -> Float64:
    """(M, 10) float64: 1, the coordinates from `origin`, and their six products."""
    x, y, z = (xyz.astype(np.float64) - origin.astype(np.float64)).T
    moments = np.empty((len(xyz), 10))
    for i, column in enumerate((1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z)):
        moments[:, i] = column
    return moments


def _covariance(sums: Float64) -> Float64:
    """(Q, 3, 3) float64 [m²] from summed moments; zero where they sum nothing."""
    mean = sums / np.maximum(sums[:, :1], 1.0)
    square = mean[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    return np.asarray(square - mean[:, 1:4, None] * mean[:, None, 1:4], np.float64)


def _spans_plane(sums: Float64) -> npt.NDArray[np.bool_]:
    """(Q,) bool: whether neighbourhoods hold three points that are not on one line."""
    c = _covariance(sums)
    trace = np.trace(c, axis1=1, axis2=2)
    # Sum of the products of two eigenvalues; zero on a line, where only one is not.
    products = (trace * trace - np.einsum("qij,qij->q", c, c)) / 2.0
    return np.asarray((sums[:, 0] >= _FEWEST) & (products > _LINE * trace * trace))


def _fit(sums: Float64, points: Float32) -> tuple[Float64, Float64]:
    """Normals and curvature from the summed moments of each neighbourhood."""
    normals = np.full((len(sums), 3), np.nan)
    curvature = np.full(len(sums), np.nan)
    spans = _spans_plane(sums)
    values, vectors = np.linalg.eigh(_covariance(sums[spans]))
    normal = vectors[:, :, 0]
    away = np.einsum("ij,ij->i", normal, points[spans].astype(np.float64)) > 0.0
    normals[spans] = np.where(away[:, None], -normal, normal)
    curvature[spans] = np.clip(values[:, 0], 0.0, None) / values.sum(axis=1)
    return normals, curvature
