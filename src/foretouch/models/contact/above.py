# SPDX-License-Identifier: Apache-2.0
"""An object as a camera straight above the table would see it, from what a camera anywhere has seen.

A camera that looks down steeply sees what the recordings show: its points are only turned into the table's frame. Of any
other view, the highest point over each cell of the table is kept, since the flanks below are not seen from above; and what
the object itself hides is taken from the other side, as if it were symmetric about the vertical line through the middle of
its top (as `grasp.completed` does). A place that the camera sees through stays empty.
"""

from typing import Final

import numpy as np

from foretouch.cloud.geometry.columns import quantiles
from foretouch.kernels import Kernel
from foretouch.types import Bool, Float64, Int64, Plane

_hide_places = Kernel("hide_places")

STEEP: Final = float(np.cos(np.radians(25.0)))
"""Cosine between line of sight and vertical from which on a view is taken as it is: objects in the recordings reach 20°."""

_CELL_M: Final = 0.003
_PITCH: Final = 0.004  # of the outline, as a tangent: two pixels of 640 x 480
_BEHIND_M: Final = 0.006  # what is so far behind a visible point is hidden by it
_MOST_CELLS: Final = 1 << 22  # of an array with a number for each
_TOP_SHARE, _TOP_M = 0.15, 0.01  # of the visible height, or so much: the top


def seen_from_above(points: Float64, table: Plane | None) -> tuple[Float64, Float64, float]:
    """Turn points into the table's frame, and complete what a tilted camera does not see of their upper side.

    Args:
        points: (N, 3) float64 [m], finite, camera frame, N > 0.
        table: The table in that frame; None if the camera looks straight down on it.

    Returns:
        (M, 3) points [m] in a frame with z downwards; the frame's axes as rows of (3, 3), by which directions and places of the camera's frame are turned; the cosine between
        line of sight and vertical, 1 without a table.
    """
    if table is None:
        return points, np.eye(3), 1.0
    sight = points.mean(axis=0)
    sight = sight / max(float(np.linalg.norm(sight)), 1e-12)
    down = np.asarray(table.normal, np.float64) / np.linalg.norm(table.normal)
    down = down if down @ sight > 0.0 else -down
    steepness = float(down @ sight)
    across = np.eye(3)[int(abs(down[0]) > 0.8)]
    across = across - (across @ down) * down
    across /= np.linalg.norm(across)
    turn = np.stack([across, np.cross(down, across), down])
    turned = points @ turn.T
    if steepness >= STEEP:
        return turned, turn, steepness
    seen = _highest(turned, len(turned))
    hidden = _mirrored(seen)
    hidden = hidden[_is_hidden(hidden @ turn, points)]
    return _highest(np.concatenate([seen, hidden]), len(seen)), turn, steepness


def _cells(points: Float64) -> tuple[Int64, int]:
    """(N,) number of the cell of the table over which each point is, and the number of cells."""
    x, y = points[:, 0], points[:, 1]
    column = np.floor((x - x.min()) / _CELL_M).astype(np.int64)
    row = np.floor((y - y.min()) / _CELL_M).astype(np.int64)
    rows = int(row.max()) + 1
    cells = column * rows + row
    count = (int(column.max()) + 1) * rows
    if count <= _MOST_CELLS:
        return cells, count
    _, cells = np.unique(cells, return_inverse=True)  # of an object that fills a room
    return cells, int(cells.max()) + 1


def _highest(points: Float64, first: int) -> Float64:
    """The highest point over each cell, by cells; one of the `first` points goes before all others."""
    cells, count = _cells(points)
    height = points[:, 2]
    chosen = np.full(count, -1)  # index of the point of each cell
    for part in (np.arange(first), np.arange(first, len(points))):
        free = part[chosen[cells[part]] < 0]
        highest = np.full(count, np.inf)
        np.minimum.at(highest, cells[free], height[free])
        best = free[height[free] == highest[cells[free]]]
        chosen[cells[best[::-1]]] = best[::-1]  # of equal ones, the first is written last
    result: Float64 = points[chosen[chosen >= 0]]
    return result


def _mirrored(points: Float64) -> Float64:
    """Half a turn about the vertical line through the middle of the top."""
    height = points[:, 2]
    low, high = quantiles(height, (0.03, 0.98))
    top = height < low + max(_TOP_SHARE * (high - low), _TOP_M)
    twin = points.copy()
    for k in (0, 1):
        values = points[top, k]
        twin[:, k] = values.min() + values.max() - twin[:, k]
    return twin


def _is_hidden(places: Float64, points: Float64) -> Bool:
    """(M,) whether points hide places from the camera, both in its frame."""
    hidden, found = np.empty(len(places), np.uint8), np.empty(1, np.int64)
    places, points = np.ascontiguousarray(places), np.ascontiguousarray(points)
    _hide_places(points, len(points), places, len(places), _PITCH, _BEHIND_M, _MOST_CELLS, hidden, found)
    if found[0] < 0:
        raise MemoryError("hide_places")
    return hidden.view(np.bool_)
