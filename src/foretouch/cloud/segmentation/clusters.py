# SPDX-License-Identifier: Apache-2.0
"""What clusters are: from which height, how they are connected, which are too small or too large.

What stands on the table of a cloud without order, one label an object: points in touching voxels.

Voxels are kept as a sorted list, not as a dense grid: its size would be the scene's, and a single far
point would blow it up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.crop import CropConfig, in_range
from foretouch.config import Settings, setting
from foretouch.types import Float32, Plane

__all__ = ["ClusterConfig", "Clusters", "HeightCut", "label_points"]


Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class ClusterConfig(Settings):
    """What stands out from the table, and what is one object."""

    min_height_m: float = setting(
        0.004, "Points lower than this above the table belong to it", minimum=0.001, maximum=0.1, unit="m"
    )
    noise_factor: float = setting(
        2.5,
        "Points also belong to the table within so many standard deviations of the depth noise measured on it",
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
        "Depth per lateral distance beyond which a neighbour does not support a pixel: without support it is flying",
        minimum=1.0,
        maximum=100.0,
    )
    voxel_m: float = setting(
        0.008, "Cells by which unorganised points are connected", minimum=0.001, maximum=0.1, unit="m"
    )
    min_points: int = setting(150, "Smaller clusters are dropped", minimum=1, maximum=10_000_000)
    min_top_m: float = setting(
        0.012,
        "Clusters that nowhere rise higher above the table are dropped as noise",
        minimum=0.0,
        maximum=0.5,
        unit="m",
    )
    max_extent_m: float = setting(
        0.6, "Clusters larger than this along an axis are dropped: a wall, an arm", minimum=0.01, maximum=10.0, unit="m"
    )


class Clusters(NamedTuple):
    """Labels of a window of the cloud.

    Attributes:
        labels: (h, w) or (n,) int32; 0 is none.
        solid: The same shape, bool: labelled, and its depth can be trusted.
        n_labels: The largest label.
        rows: First row of the part, 0 where not organised.
        columns: First column of the part.
    """

    labels: Int32
    solid: Bool
    n_labels: int
    rows: int = 0
    columns: int = 0


class HeightCut(NamedTuple):
    """From which height a point no longer belongs to the table, growing with its depth as stereo noise does.

    Attributes:
        plane: The table.
        low_m: Least height [m].
        noise_per_m: Least height divided by z² [1/m].
        high_m: Greatest height [m].
    """

    plane: Plane
    low_m: float
    noise_per_m: float
    high_m: float

    def at(self, z: Float32) -> Float32:
        """The least height of points of a depth (...), float32 [m]."""
        cut: Float32 = z * np.float32(self.noise_per_m)
        cut *= z
        return np.maximum(cut, np.float32(self.low_m), out=cut)

    def measure(self, xyz: Float32, z: Float32) -> tuple[Float32, Bool]:
        """How high points are, and whether they stand out.

        Args:
            xyz: (..., 3) float32 [m].
            z: (...), its depths; contiguous, they are read faster than from `xyz`.

        Returns:
            (...) float32 [m], not finite without depth, and (...) bool, false there.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            height: Float32 = self.plane.height(xyz).astype(np.float32, copy=False)
            above = height > self.at(z)
            above &= height < np.float32(self.high_m)
            return height, above


def label_points(xyz: Float32, crop: CropConfig, cut: HeightCut, config: ClusterConfig) -> list[Clusters]:
    """Label a cloud without order: points in touching voxels belong together.

    Args:
        xyz: (N, 3) float32 [m].
        crop: Depths that count.
        cut: What is table.
        config: What is one object.

    Returns:
        The one window that holds all points, none where nothing stands out. The labels still hold small clusters.
    """
    z = np.ascontiguousarray(xyz[:, 2])
    above = np.flatnonzero(cut.measure(xyz, z)[1] & in_range(z, crop))
    if not len(above):
        return []
    cells = np.floor(xyz[above] / np.float32(config.voxel_m)).astype(np.int64)
    component, count = _label_voxels(cells)
    labels = np.zeros(len(xyz), np.int32)
    labels[above] = component
    return [Clusters(labels, labels > 0, count)]


def _label_voxels(cells: npt.NDArray[np.int64]) -> tuple[Int32, int]:
    """Components of occupied cells (n, 3), all 26 neighbours connected.

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
    # Half of the 26 directions: a link needs one entry only.
    for offset in np.ndindex(3, 3, 3):
        if offset > (1, 1, 1):
            wanted = keys + int((np.array(offset) - 1) @ weights)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = np.flatnonzero(keys[place] == wanted)
            pairs.append((hit, place[hit]))
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(len(keys), len(keys)))
    count, component = connected_components(graph, directed=False)
    return (component[member] + 1).astype(np.int32), int(count)
