# SPDX-License-Identifier: Apache-2.0
"""Input of the touch models: a fixed number of points, moved and scaled to the unit sphere."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from foretouch.cloud.geometry.columns import centred_columns, distances
from foretouch.errors import CloudError
from foretouch.types import Float64, Floating, Int64

_MAX_M = 1e30  # whose square is a number in float64
_MIN_SCALE_M = 1e-6  # a smaller cloud is one point and the rounding of float32


def sample_indices(size: int, n: int, rng: np.random.Generator) -> Int64:
    """Return (n,) int64 indices of `n` of `size` points at random, all different; of fewer all, and some repeatedly.

    Args:
        size: Number of points.
        n: Number of indices.
        rng: Draws them.

    Raises:
        CloudError: If there is no point, or `n` is not positive.
    """
    if size < 1 or n < 1:
        raise CloudError(f"xyz: {n} of {size} points cannot be drawn")
    if size <= n:
        return np.concatenate([rng.permutation(size), rng.integers(0, size, n - size)]).astype(np.int64)
    return rng.choice(size, n, replace=False).astype(np.int64)


@dataclass(frozen=True, eq=False)
class UnitSphereFrame:
    """Moves and scales a cloud to the unit sphere (P1, section III.A)."""

    centre: Float64  # (3,) float64 [m], centroid of the cloud
    scale: float  # distance of its farthest point from the centroid [m]

    @classmethod
    def fit(cls, xyz: Floating) -> Self:
        """Return the frame of a cloud.

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
        """Map (..., 3) points [m] to the unit sphere, as float64."""
        return (np.asarray(points, np.float64) - self.centre) / self.scale
