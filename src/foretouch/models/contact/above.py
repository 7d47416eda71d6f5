# SPDX-License-Identifier: Apache-2.0
"""An object as a camera straight above the table would see it, from what a camera anywhere has seen.

A camera that looks down steeply sees what the recordings show: its points are only turned into the table's frame. Of any
other view, the highest point over each cell of the table is kept, since the flanks below are not seen from above; and what
the object itself hides is taken from the other side, as if it were symmetric about a vertical line. That line is where
half a turn moves visible points to others of the same height, and to hidden places. A place that the camera sees through
stays empty.

Which walls are in view depends on where the camera is, and so do sizes of all points. The upper side without its walls
(`upper_side`) is what two views of an object share.
"""

import math
from typing import Final

import numpy as np
from scipy.ndimage import minimum_filter

from foretouch.cloud.geometry.columns import quantiles
from foretouch.grasp.pose import cross
from foretouch.kernels import Kernel
from foretouch.types import Bool, Float64, Int64, Plane

_hide_places = Kernel("hide_places")

STEEP: Final = float(np.radians(17.0))
"""Angle between line of sight and vertical up to which a view is taken as it is: objects in the recordings reach 17° [rad]."""

_DOWN: Final = np.array([0.0, 0.0, 1.0])  # along the optical axis
_CELL_M: Final = 0.003
_UPPER_M: Final = 0.005  # edge of the cells of an upper side: two pixels of 640 x 480 at 1.3 m
_MOST_ALONG: Final = 256  # of these cells along one side
_WALL: Final = 1.8  # slope, as a tangent, from which on a cell is at a wall
_STEEP_WALL: Final = 5.0  # the same where sizes of what is seen from above are measured: there rounded sides count
_FEWEST: Final = 8  # cells that show a shape
_PITCH: Final = 0.004  # of the outline, as a tangent: two pixels of 640 x 480
_BEHIND_M: Final = 0.006  # what is so far behind a visible point is hidden by it
_MOST_CELLS: Final = 1 << 22  # of an array with a number for each
_TOP_SHARE, _TOP_M = 0.05, 0.004  # of the visible height, or so much: the top
_AWAY_M: Final = np.arange(-0.008, 0.0121, 0.002)  # along the view from the middle of the top: places of the line
_UNLIKE_M: Final = 0.005  # difference of heights that counts as much as a place which the camera sees through
_TWINS: Final = 400  # points at most, by which a line is evaluated


def seen_from_above(points: Float64, centre: Float64, table: Plane | None) -> tuple[Float64, Float64, Float64]:
    """Turn points into the table's frame, and complete what a tilted camera does not see of their upper side.

    Args:
        points: (N, 3) float64 [m], finite, camera frame, N > 0.
        centre: (3,) float64, their mean [m].
        table: The table in that frame; None if the camera looks straight down on it.

    Returns:
        (M, 3) points [m] in a frame with z downwards; the frame's axes as rows of (3, 3), by which directions and places of the camera's frame are turned; (2,) the angle between
        line of sight and vertical [rad], and the distance of the object [m].
    """
    distance = max(math.hypot(*centre.tolist()), 1e-12)
    down = _DOWN if table is None else np.asarray(table.normal, np.float64)
    down = down / math.hypot(*down.tolist())
    down = down if down @ centre > 0.0 else -down
    view = np.array([math.acos(min(float(down @ centre) / distance, 1.0)), distance])
    if table is None:
        return points, np.eye(3), view
    across = np.eye(3)[int(abs(down[0]) > 0.8)]
    across = across - (across @ down) * down
    across /= math.hypot(*across.tolist())
    turn = np.stack([across, cross(down, across), down])
    turned = points @ turn.T
    if view[0] <= STEEP:
        return turned, turn, view
    return _completed(_highest(turned, _CELL_M), _CELL_M, turn, points), turn, view


def upper_side(points: Float64, turn: Float64, tilt: float) -> Float64:
    """Return what an object shows of itself in all views: its upper side without walls, a point over each cell of the table.

    Args:
        points: (N, 3) float64 [m], finite, camera frame, N > 0.
        turn: (3, 3) axes of the table's frame as rows, as from `seen_from_above`.
        tilt: Angle between line of sight and vertical [rad]. What a tilted camera does not see is completed.

    Returns:
        (U, 3) [m] in a frame with z downwards and x along the object. All points if it has hardly any upper side.
    """
    along = _along_object(points @ turn.T) @ turn
    turned = points @ along.T
    x, y, z = np.ascontiguousarray(turned.T)  # reductions over rows of three take several times as long
    low, edge = np.array([x.min(), y.min()]), _edge(x, y, _UPPER_M)
    column, row = (np.floor((values - values.min()) / edge).astype(np.int64) for values in (x, y))
    columns, rows = int(column.max()) + 1, int(row.max()) + 1
    cells = column * rows + row
    height = np.full(columns * rows, np.inf)
    np.minimum.at(height, cells, z)
    highest = np.flatnonzero(z <= height.take(cells) + edge / 2.0)
    cells, points_of = cells.take(highest), [values.take(highest) for values in (x, y, z)]
    counts = np.bincount(cells, minlength=height.size)
    filled = np.flatnonzero(counts)
    means = np.stack([np.bincount(cells, values)[filled] for values in points_of], axis=1) / counts[filled, None]
    upper: Float64 = means[_falls(means, low, edge) <= _WALL * edge]
    if len(upper) < _FEWEST:
        return turned
    return upper if tilt <= STEEP else _completed(upper, edge, along, points)


def without_walls(points: Float64) -> Float64:
    """Return the points that a camera above shows of an object, from what one anywhere sees of it: all but those at walls.

    Args:
        points: (N, 3) float64 [m], about one over each cell, as from `seen_from_above`.
    """
    edge = _edge(points[:, 0], points[:, 1], _CELL_M)
    upper: Float64 = points[_falls(points, points[:, :2].min(axis=0), edge) <= _STEEP_WALL * edge]
    return upper if len(upper) >= _FEWEST else points


def _edge(x: Float64, y: Float64, least: float) -> float:
    """Return the edge of square cells [m], of which there are not too many over all points at (N,) x and y."""
    return max(least, float(np.ptp(x)) / _MOST_ALONG, float(np.ptp(y)) / _MOST_ALONG)


def _falls(points: Float64, low: Float64, edge: float) -> Float64:
    """Return (N,) [m], how far points are below the highest one over their cell and those around it. The first cell begins at `low`."""
    x, y, z = np.ascontiguousarray(points.T)
    column, row = (  # a mean may round below
        np.maximum(np.floor((values - first) / edge), 0.0).astype(np.int64)
        for values, first in zip((x, y), low, strict=True)
    )
    height = np.full((int(column.max()) + 1, int(row.max()) + 1), np.inf)
    np.minimum.at(height, (column, row), z)
    around = minimum_filter(height, 3, mode="constant", cval=np.inf)
    return np.asarray(z - around[column, row], np.float64)


def _along_object(points: Float64) -> Float64:
    """Return (3, 3) turn about the vertical after which an object is longest along x, so that its cells turn with it."""
    x, y = (values - values.mean() for values in np.ascontiguousarray(points[:, :2].T))
    angle = 0.5 * np.arctan2(2.0 * (x @ y), x @ x - y @ y)
    cosine, sine = np.cos(angle), np.sin(angle)
    place = cosine * x + sine * y
    if (place * place * place).sum() < 0.0:  # a power takes twenty times as long
        cosine, sine = -cosine, -sine
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _completed(seen: Float64, edge: float, turn: Float64, points: Float64) -> Float64:
    """Return (M, 3) seen points of an upper side, one over each cell, with what (N, 3) points hide from the camera."""
    hidden = _half_turn(seen, _middle(seen, edge, turn, points))
    hidden = hidden[_is_hidden(hidden @ turn, points)]
    cells, count = _cells(np.concatenate([seen, hidden]), edge)
    taken = np.zeros(count, np.bool_)
    taken[cells[: len(seen)]] = True
    free, first = np.unique(cells[len(seen) :], return_index=True)
    return np.concatenate([seen, hidden[first[~taken[free]]]])


def _cells(points: Float64, edge: float) -> tuple[Int64, int]:
    """Return (N,) number of the cell of the table over which each point is, and the number of cells."""
    x, y = np.ascontiguousarray(points[:, :2].T)
    column = np.floor((x - x.min()) / edge).astype(np.int64)
    row = np.floor((y - y.min()) / edge).astype(np.int64)
    rows = int(row.max()) + 1
    cells = column * rows + row
    count = (int(column.max()) + 1) * rows
    if count <= _MOST_CELLS:
        return cells, count
    _, cells = np.unique(cells, return_inverse=True)  # of an object that fills a room
    return cells, int(cells.max()) + 1


def _highest(points: Float64, edge: float) -> Float64:
    """Return the highest point over each cell, by cells; of equal ones, the first."""
    (cells, count), height = _cells(points, edge), points[:, 2].copy()
    highest = np.full(count, np.inf)
    np.minimum.at(highest, cells, height)
    best = np.flatnonzero(height == highest[cells])
    chosen = np.full(count, -1)  # index of the point of each cell
    chosen[cells[best[::-1]]] = best[::-1]  # the first is written last
    result: Float64 = points[chosen[chosen >= 0]]
    return result


def _middle(seen: Float64, edge: float, turn: Float64, points: Float64) -> Float64:
    """Return (2,) [m], where the vertical line is about which seen points of an upper side, one over each cell, are symmetric.

    Across the view, where both sides are seen, it is in the middle of the top. Along the view the far side of a rounded top is hidden, and the
    line is chosen by what half a turn about it does: heights must agree, and what is moved to a free place must be hidden.
    """
    x, y, height = np.ascontiguousarray(seen.T)
    low, high = quantiles(height, (0.03, 0.98))
    top = height < low + max(_TOP_SHARE * (high - low), _TOP_M)
    start = np.array([values[top].min() + values[top].max() for values in (x, y)]) / 2.0
    away = np.array([x.mean(), y.mean()])
    away /= max(float(np.hypot(*away)), 1e-12)
    middles = start + _AWAY_M[:, None] * away
    twins = _half_turn(seen[:: -(-len(seen) // _TWINS)], middles[:, None])
    cells, count = _cells(np.concatenate([seen, twins.reshape(-1, 3)]), edge)
    heights = np.full(count, np.nan)
    heights[cells[: len(seen)]] = height
    apart = np.abs(heights[cells[len(seen) :]].reshape(twins.shape[:2]) - twins[:, :, 2])
    empty = np.isnan(apart)
    apart[empty] = np.where(_is_hidden(twins[empty] @ turn, points), np.nan, _UNLIKE_M)
    shown = ~np.isnan(apart)
    cost = np.minimum(apart, _UNLIKE_M).sum(axis=1, where=shown) / np.maximum(shown.sum(axis=1), 1)
    best = int(np.argmin(cost))
    if not 0 < best < len(cost) - 1:
        return np.asarray(middles[best], np.float64)
    before, least, after = cost[best - 1 : best + 2]
    curvature = before - 2.0 * least + after  # of the parabola through three costs, whose least is between them
    part = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
    return np.asarray(middles[best] + part * (_AWAY_M[1] - _AWAY_M[0]) * away, np.float64)


def _half_turn(points: Float64, middle: Float64) -> Float64:
    """Turn (..., 3) points by half a turn about the vertical lines through (..., 2) middles."""
    x, y = (2.0 * middle[..., axis] - points[:, axis] for axis in (0, 1))  # by columns in a fifth of the time
    return np.stack([x, y, np.broadcast_to(points[:, 2], x.shape)], axis=-1)


def _is_hidden(places: Float64, points: Float64) -> Bool:
    """Return (M,) whether points hide places from the camera, both in its frame."""
    hidden, found = np.empty(len(places), np.uint8), np.empty(1, np.int64)
    places, points = np.ascontiguousarray(places), np.ascontiguousarray(points)
    _hide_places(points, len(points), places, len(places), _PITCH, _BEHIND_M, _MOST_CELLS, hidden, found)
    if found[0] < 0:
        raise MemoryError("hide_places")
    return hidden.view(np.bool_)
