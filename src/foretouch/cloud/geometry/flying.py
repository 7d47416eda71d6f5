# SPDX-License-Identifier: Apache-2.0
"""Flying points: pixels of a depth camera that lie in the air, between two depths along their ray.

The segmentation of an image removes most (see `foretouch.cloud.segmentation.clusters`). Lists of points, and objects that
another program has cut out, hold them.
"""

import numpy as np

from foretouch.kernels import Kernel
from foretouch.types import Bool, Float32

_flying = Kernel("flying_points")

_NEIGHBOURS = 20.0  # that a point has on average, of all whose rays are near
_GAP_M = 0.008  # in depth, up to which neighbours support each other, as `ClusterConfig.gap_m`,
_SLOPE = 2.0  # or this multiple of their lateral distance
# Of the neighbours, at least the first share is behind it, or before it, and at most the second supports it: the end of a wire has two.
# Where points fly, some of them are near each other by chance.
_FIRST, _AGAIN = (0.5, 1.0), (0.75, 3.0)


def flying_mask(xyz: Float32, least_share: float) -> Bool:
    """Mark points that are alone in front of those around them, or alone behind them.

    The rim of any object has some: none is marked in a cloud of few, so that its grasps do not depend on them.

    Args:
        xyz: (N, 3) float32 [m], finite, of one object, camera optical frame. N may be 0.
        least_share: Of the points, from which on they are marked.

    Returns:
        (N,) bool; all False if a point is not in front of the camera.

    Raises:
        MemoryError: If there is too little memory.
    """
    flying, radius = np.empty(len(xyz), np.uint8), np.empty(1)
    least = max(least_share * len(xyz), 1.0)
    settings = np.array([_NEIGHBOURS, least, _GAP_M, _SLOPE, *_FIRST, *_AGAIN])
    _flying(np.ascontiguousarray(xyz), len(xyz), settings, flying, radius)
    if radius[0] < 0.0:
        raise MemoryError("flying_points")
    return flying.view(np.bool_)
