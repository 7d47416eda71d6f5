# SPDX-License-Identifier: Apache-2.0
"""A first cloud, worked through while a node configures, so that the first real one is not late.

Half a second of imports and first allocations otherwise falls on the first clouds, which then wait for
each other.
"""

from __future__ import annotations

import numpy as np

from foretouch.types import Cloud, Float32

__all__ = ["tabletop"]

_ROWS, _COLUMNS = 120, 160
_TABLE_M, _BOX_TOP_M = 0.8, 0.7  # distance from the camera


def tabletop() -> Cloud:
    """A grey box on a table, seen from above: (120, 160, 3) float32 [m]; models with colours want some."""
    row, column = np.mgrid[0:_ROWS, 0:_COLUMNS].astype(np.float32)
    depth = np.full((_ROWS, _COLUMNS), _TABLE_M, np.float32)
    depth[45:75, 60:100] = _BOX_TOP_M
    ray_x, ray_y = (column - _COLUMNS / 2) / 160.0, (row - _ROWS / 2) / 160.0
    xyz: Float32 = np.stack([ray_x * depth, ray_y * depth, depth], axis=-1)
    return Cloud(xyz, np.full(xyz.shape, 128, np.uint8), frame_id="warm_up")
