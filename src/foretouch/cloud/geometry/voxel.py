# SPDX-License-Identifier: Apache-2.0
"""A voxel grid anchored at the origin of coordinates, after PCL's VoxelGrid as GeoGrasp uses it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError
from foretouch.types import Float32, Float64

__all__ = ["VoxelGrid", "voxel_grid"]


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Which of M occupied cells each of N points lies in.

    Attributes:
        cell: (N,) int64, 0 ... M - 1; cells are ordered x fastest, then y, then z.
        counts: (M,) int64, points a cell, at least 1.
        leaf_m: Edge of a cell [m].
    """

    cell: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int64]
    leaf_m: float

    def mean(self, values: npt.NDArray[np.floating]) -> Float64:
        """Mean over the points of each cell.

        Args:
            values: (N, C) floating. A NaN spreads to its whole cell, in its column only.

        Returns:
            (M, C) float64.
        """
        means = np.empty((len(self.counts), values.shape[1]))
        for i, column in enumerate(values.T):
            means[:, i] = np.bincount(self.cell, column, minlength=len(self.counts)) / self.counts
        return means


def voxel_grid(xyz: Float32, leaf_m: float) -> VoxelGrid:
    """Sort points into cubes whose corners are multiples of the edge, whatever the cloud's extent.

    The cell is floor(x · (1/leaf)) in float32, as in PCL: points on a face would otherwise change sides.

    Args:
        xyz: (N, 3) float32 [m], finite. N may be 0.
        leaf_m: Edge of a cube [m].

    Raises:
        CloudError: If the cloud spans more cells than can be numbered.
    """
    if len(xyz) == 0:
        return VoxelGrid(np.zeros(0, np.int64), np.zeros(0, np.int64), leaf_m)
    per_m = np.float32(1.0) / np.float32(leaf_m)
    ijk = np.floor(np.ascontiguousarray(xyz.T) * per_m).astype(np.float64)
    ijk -= ijk.min(axis=1, keepdims=True)
    size = ijk.max(axis=1) + 1.0
    if not np.prod(size) < 2.0**62:
        raise CloudError(f"xyz: spans {size.tolist()} cells of {leaf_m} m, too many to number")
    i, j, k = ijk.astype(np.int64)
    key = i + int(size[0]) * (j + int(size[1]) * k)
    _, cell, counts = np.unique(key, return_inverse=True, return_counts=True)
    return VoxelGrid(cell.reshape(-1), counts, leaf_m)
