# SPDX-License-Identifier: Apache-2.0
"""Input of the touch models: a fixed number of points, moved and scaled to the unit sphere."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from foretouch.cloud.geometry.columns import centred_columns, distances
from foretouch.errors import CloudError
from foretouch.types import Float64, Floating, Int64

SAMPLERS = ("random", "voxel", "farthest")
_VOXEL_HALVINGS = 20  # of the voxel's edge: 21 bits hold a cell's index, and float32 resolves little more
_MAX_M = 1e30  # whose square is a number in float64
_MIN_SCALE_M = 1e-6  # a smaller cloud is one point and the rounding of float32


def sample_indices(xyz: Floating, n: int, *, method: str = "random", rng: np.random.Generator) -> Int64:
    """Indices of a fixed number of points.

    If the cloud has fewer than `n` points, all are returned, and some repeatedly, drawn at random.

    Args:
        xyz: (N, 3) floating [m], finite, N > 0.
        n: Number of points, > 0.
        method: "random" without replacement; "voxel", one point drawn from each cell of the coarsest grid
            that has at least `n` occupied cells; "farthest", farthest-point sampling from a random first point.
        rng: Source of randomness.

    Returns:
        (n,) int64, all different where N >= n.

    Raises:
        CloudError: If the cloud is empty or not finite, `n` is not positive, or the method is unknown.
    """
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) == 0:
        raise CloudError(f"xyz: shape {xyz.shape} is not (N, 3) with N > 0")
    if n < 1:
        raise CloudError(f"n: {n} is not a positive number of points")
    if method not in SAMPLERS:
        raise CloudError(f"method: {method!r} is not one of {', '.join(SAMPLERS)}")
    if not np.isfinite(xyz).all():
        raise CloudError("xyz: contains points that are not finite")
    size = len(xyz)
    if size <= n:
        return np.concatenate([rng.permutation(size), rng.integers(0, size, n - size)]).astype(np.int64)
    if method == "farthest":
        return _farthest(xyz, n, int(rng.integers(size)))
    if method == "voxel":
        return _one_per_voxel(xyz, n, rng)
    return rng.choice(size, n, replace=False).astype(np.int64)


def _farthest(xyz: Floating, n: int, first: int) -> Int64:
    """Farthest-point sampling; coordinates are contiguous, and the loop allocates no array."""
    columns = [np.ascontiguousarray(xyz[:, axis], np.float32) for axis in range(3)]
    nearest = np.full(len(xyz), np.inf, np.float32)
    squared, term = np.empty_like(nearest), np.empty_like(nearest)
    chosen = np.empty(n, np.int64)
    chosen[0] = first
    for k in range(1, n):
        latest = chosen[k - 1]
        squared[:] = 0.0
        for column in columns:
            np.subtract(column, column[latest], out=term)
            np.multiply(term, term, out=term)
            np.add(squared, term, out=squared)
        np.minimum(nearest, squared, out=nearest)
        nearest[latest] = -1.0  # of coinciding points each is taken once
        chosen[k] = nearest.argmax()
    return chosen


def _one_per_voxel(xyz: Floating, n: int, rng: np.random.Generator) -> Int64:
    """One point per voxel, reduced at random to n; filled up if coinciding points leave too few voxels."""
    shuffled = rng.permutation(len(xyz))  # the first point of a cell is then a random one
    points = xyz[shuffled].astype(np.float64)
    points -= points.min(axis=0)
    extent = float(points.max())
    first = np.zeros(1, np.int64)
    for step in range(_VOXEL_HALVINGS):
        cells = (
            np.floor(points * (2.0**step / extent)).astype(np.int64)
            if extent > 0.0
            else np.zeros_like(points, np.int64)
        )
        _, first = np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2], return_index=True)
        if len(first) >= n:
            return shuffled[rng.choice(first, n, replace=False)].astype(np.int64)
    rest = np.setdiff1d(np.arange(len(xyz)), first)
    chosen: Int64 = shuffled[np.concatenate([first, rng.choice(rest, n - len(first), replace=False)])]
    return chosen


@dataclass(frozen=True, eq=False)
class UnitSphereFrame:
    """Moves and scales a cloud to the unit sphere (P1, section III.A)."""

    centre: Float64  # (3,) float64 [m], centroid of the cloud
    scale: float  # distance of its farthest point from the centroid [m]

    @classmethod
    def fit(cls, xyz: Floating) -> Self:
        """The frame of a cloud.

        Args:
            xyz: (N, 3) floating [m], finite, N > 0.

        Raises:
            CloudError: If there is no point, one is not finite or beyond 1e30 m, or all coincide.
        """
        points = np.asarray(xyz, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
            raise CloudError(f"xyz: shape {points.shape} is not (N, 3) with N > 0")
        if not np.isfinite(points).all():
            raise CloudError("xyz: contains points that are not finite")
        if np.abs(points).max() > _MAX_M:
            raise CloudError(f"xyz: {np.abs(points).max():g} m exceeds {_MAX_M:g} m")
        centre, columns, _ = centred_columns(points)
        scale = float(distances(columns).max())
        if scale < _MIN_SCALE_M:
            raise CloudError(f"xyz: all {len(points)} points coincide at {centre.tolist()}")
        return cls(centre, scale)

    def apply_points(self, points: Floating) -> Float64:
        """(..., 3) [m] to the unit sphere, float64."""
        return (np.asarray(points, np.float64) - self.centre) / self.scale
