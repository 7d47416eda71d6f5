# SPDX-License-Identifier: Apache-2.0
"""Clustering of the points above the table: settings, height threshold, and Euclidean clusters of unorganised clouds.

Unorganised points are connected if their voxels touch. Occupied voxels are a sorted list, not a dense grid: the size of
a grid would be the scene's, and a single far point would make it huge.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.crop import CropConfig, in_range
from foretouch.config import Settings, setting
from foretouch.kernels import Kernel
from foretouch.types import Float32, Plane

_plane_heights = Kernel("plane_heights", np.float32, int, np.float32, np.float32)

Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class ClusterConfig(Settings):
    """Which points are above the table, and which of them are one object."""

    min_height_m: float = setting(
        0.004, "Points lower than this above the table belong to it", minimum=0.001, maximum=0.1, unit="m"
    )
    noise_factor: float = setting(
        2.5,
        "Points within so many standard deviations of the depth noise, measured on the table, also belong to it",
        minimum=0.0,
        maximum=10.0,
    )
    max_height_m: float = setting(
        0.6, "Points higher than this above the table are ignored", minimum=0.01, maximum=5.0, unit="m"
    )
    gap_m: float = setting(
        0.008, "Neighbouring pixels that differ less in depth are connected", minimum=0.001, maximum=0.1, unit="m"
    )
    max_slope: float = setting(
        20.0,
        "Depth per lateral distance up to which neighbouring pixels are connected: a face seen at 87 degrees",
        minimum=1.0,
        maximum=100.0,
    )
    flying_slope: float = setting(
        4.0,
        "Depth per lateral distance beyond which a neighbour does not support a pixel; unsupported pixels are flying",
        minimum=1.0,
        maximum=100.0,
    )
    voxel_m: float = setting(
        0.008, "Voxel size for connecting unorganised points", minimum=0.001, maximum=0.1, unit="m"
    )
    min_points: int = setting(150, "Smaller clusters are dropped", minimum=1, maximum=10_000_000)
    min_top_m: float = setting(
        0.012, "Clusters that do not rise higher above the table are dropped", minimum=0.0, maximum=0.5, unit="m"
    )
    max_extent_m: float = setting(
        0.6, "Clusters larger than this along an axis are dropped: a wall, an arm", minimum=0.01, maximum=10.0, unit="m"
    )


class Clusters(NamedTuple):
    """Cluster labels of a window of the cloud."""

    labels: Int32  # (h, w) int32, an unorganised cloud in one row; 0 is none
    solid: Bool  # the same shape, bool: labelled, with a reliable depth
    n_labels: int  # the largest label
    rows: int = 0  # first row of the window, 0 if unorganised
    columns: int = 0  # first column of the window, 0 if unorganised


class HeightThreshold(NamedTuple):
    """Height from which a point does not belong to the table; it grows with depth like stereo noise."""

    plane: Plane  # the table
    low_m: float  # minimum height [m]
    noise_per_m: float  # minimum height divided by z² [1/m]
    high_m: float  # maximum height [m]

    def at(self, z: Float32) -> Float32:
        """The minimum height of points at depth z (...), float32 [m]."""
        minimum: Float32 = z * np.float32(self.noise_per_m)
        minimum *= z
        return np.maximum(minimum, np.float32(self.low_m), out=minimum)

    def measure(self, xyz: Float32, z: Float32) -> tuple[Float32, Bool]:
        """Heights of points, and whether they are between the minimum and the maximum height.

        Args:
            xyz: (..., 3) float32 [m].
            z: (...), their depths; contiguous, they are read faster than from `xyz`.

        Returns:
            (...) float32 [m], not finite without depth, and (...) bool, false there.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            height = heights(self.plane, xyz)
            above = height > self.at(z)
            above &= height < np.float32(self.high_m)
            return height, above


def heights(plane: Plane, xyz: Float32) -> Float32:
    """Heights (...) float32 of contiguous points (..., 3) above the table [m], summed in an order that no library changes."""
    found = np.empty(xyz.shape[:-1], np.float32)
    _plane_heights(xyz, found.size, plane.coefficients.astype(np.float32), found)
    return found


def label_unorganised(
    xyz: Float32, crop: CropConfig, threshold: HeightThreshold, config: ClusterConfig
) -> list[Clusters]:
    """Label an unorganised cloud: points in touching voxels are one cluster.

    Args:
        xyz: (N, 3) float32 [m].
        crop: Depth range.
        threshold: Height threshold above the table.
        config: Settings.

    Returns:
        One window with all points, or none if nothing is above the table. Small clusters are not yet removed.
    """
    z = np.ascontiguousarray(xyz[:, 2])
    above = np.flatnonzero(threshold.measure(xyz, z)[1] & in_range(z, crop))
    if not len(above):
        return []
    cells = np.floor(xyz[above] / np.float32(config.voxel_m)).astype(np.int64)
    component, count = _label_voxels(cells)
    labels = np.zeros((1, len(xyz)), np.int32)
    labels[0, above] = component
    return [Clusters(labels, labels > 0, count)]


def _label_voxels(cells: npt.NDArray[np.int64]) -> tuple[Int32, int]:
    """Connected components of occupied cells (n, 3), with 26 neighbours.

    Returns:
        (n,) int32 from 1, and the number of components.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    cells = cells - cells.min(axis=0) + 1
    size = cells.max(axis=0) + 2
    weights = np.array([size[1] * size[2], size[2], 1])
    keys, member = np.unique(cells @ weights, return_inverse=True)
    pairs = []
    # Half of the 26 directions: an undirected edge needs one entry only.
    for offset in np.ndindex(3, 3, 3):
        if offset > (1, 1, 1):
            wanted = keys + int((np.array(offset) - 1) @ weights)
            index = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = np.flatnonzero(keys[index] == wanted)
            pairs.append((hit, index[hit]))
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(len(keys), len(keys)))
    count, component = connected_components(graph, directed=False)
    return (component[member] + 1).astype(np.int32), int(count)
