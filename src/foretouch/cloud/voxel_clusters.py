# SPDX-License-Identifier: Apache-2.0
"""What stands on the table of a cloud without order, one label an object: points in touching voxels.

Voxels are kept as a sorted list, not as a dense grid: its size would be the scene's, and a single far
point would blow it up.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from foretouch.cloud.clusters import ClusterConfig, Clusters, HeightCut
from foretouch.cloud.crop import CropConfig, in_range
from foretouch.types import Float32

__all__ = ["label_points"]

Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]


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
