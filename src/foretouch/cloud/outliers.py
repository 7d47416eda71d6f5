# SPDX-License-Identifier: Apache-2.0
"""Statistical outlier removal, after PCL's StatisticalOutlierRemoval as GeoGrasp uses it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from foretouch.cloud.neighbours import mean_neighbour_distance
from foretouch.cloud.pixel_window import PixelGrid
from foretouch.types import Float32

__all__ = ["inlier_mask"]


def inlier_mask(
    xyz: Float32, neighbours: int = 50, deviations: float = 1.0, grid: PixelGrid | None = None
) -> npt.NDArray[np.bool_]:
    """Points whose neighbours are not unusually far: mean distance <= mean + deviations · std of the cloud.

    The deviation is that of a sample (n - 1). A cloud of one point keeps it.

    Args:
        xyz: (N, 3) float32 [m], finite. N may be 0.
        neighbours: Nearest neighbours that are averaged for each point, itself excluded.
        deviations: Standard deviations above the mean that are still kept.
        grid: The pixels at which the points were seen; speeds it up and does not change the answer.

    Returns:
        (N,) bool.
    """
    if len(xyz) < 2:
        return np.ones(len(xyz), np.bool_)
    distance = mean_neighbour_distance(xyz, neighbours, grid).astype(np.float64)
    return np.asarray(distance <= distance.mean() + deviations * distance.std(ddof=1))
