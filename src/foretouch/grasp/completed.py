# SPDX-License-Identifier: Apache-2.0
"""The default method: horizontal grasps through the middle of the object, whose unseen side is estimated.

A camera sees one side of an object. The extremes of what it sees, which the published GeoGrasp takes as contacts, lie in
front of the object's middle and above it, and two fingers that close there slide off. This method

1. completes the object: it stands on the table, and is symmetric about the vertical line through the middle of its top,
   as far as its outline in the image allows. A place that the camera sees through is free;
2. closes along horizontal lines, in 24 directions and at many places, each at half the height of the object there, or of
   what the camera does not see through;
3. refuses lines that the hand cannot execute: wider than it opens, too low for a fingertip, or with another object in the
   way of a finger that comes from outside along the line;
4. prefers lines that are short, near the object's centre of mass (of the completed object, with equal density), meet
   both sides at a right angle, run across the view, where both sides are seen, and end neither where the camera sees through nor
   beside pixels without depth (`foretouch.grasp.unseen`).

Every measure is a quantile or a mean, so that it changes little when the cloud changes little.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from heapq import heappop, heappush
from typing import Any, Literal

import numpy as np

from foretouch.cloud.geometry.columns import median
from foretouch.cloud.geometry.pcl_filters import cell_means, voxel_grid
from foretouch.errors import CloudError
from foretouch.grasp.carry import strain
from foretouch.grasp.config import HandConfig
from foretouch.grasp.frame import PREFERRED, WeightedPoints, smoothstep
from foretouch.grasp.hand import UNLIMITED_M
from foretouch.grasp.hold import APART_M
from foretouch.grasp.outline import SeenOutline
from foretouch.grasp.pose import cross
from foretouch.grasp.unseen import DepthAround
from foretouch.kernels import Kernel, struct
from foretouch.types import Bool, Float32, Float64, Floating, Grasp, Int64, Plane, WayIn
from foretouch.types.grasps import TILTS
from foretouch.types.scene import Obstacles

_closing_lines = Kernel("closing_lines")
_outline = Kernel("outline")
_complete_object = Kernel("complete_object")

_ANGLES = 24  # directions in half a turn
_LINES = 17  # in each direction, next to the centre
_STEP_M = 0.004  # from one line to the next; a line takes the points up to twice that beside it, with falling weight
_NEAR = 2  # lines and directions on either side, of which the best grasp is a mean
_END_SHARE = 0.03  # of the points of a line that are beyond either end, while lines are compared
_OUTER_SHARE = 0.006  # the same where the object ends
# By how much an object may be wider than planned: of its width, along the view, where a side is hidden; and pixels, at its outline.
_HIDDEN, _PIXELS = 0.3, 2.2
_STEPS_OF_POINTS = 4.0  # in place of pixels, of points without their image
_UPRIGHT = 0.25  # of the points, which the camera sees nearly upright, so that their distances are those in the image
_PITCH = 0.004  # of the outline's grid, as a tangent: two pixels of 640 x 480
_SPACINGS = 0.55  # mean distances to the neighbours in a cell of that grid, at least
_FLOATING_M = 0.3  # above the table, where no object stands that is all above it: the table is another
_THIN_M = 0.001  # shorter lines hold nothing
_ALMOST = 0.96  # of the opening of tips, from where on a line costs the more the wider it is
_ALMOST_HAND = 0.85  # of the opening of a hand with a palm
MAY_NOT_FIT = "may_not_fit"
"""Flag of a grasp whose object may be wider between the contacts than the hand opens."""

REASONS = ("n_too_flat", "n_too_wide", "n_too_thin", "n_blocked")  # counts of refused lines, in this order
# The cost of a line is 1 for each of these, squared but for the width and the share of the view.
_DISTANCE_M = 0.015  # beside the centre of mass
_SLOPE_DEG = 40.0  # of either side against the line
_ACROSS = 0.3  # cost of a line along the view, whose far side is not seen
_WIDTH_M = 0.1  # from one side to the other
_HOLLOW = 3.0  # cost of a line whose ends the camera sees through
_WIDE = 3.0  # cost of a line as wide as the hand opens, so that noise does not decide what is just about refused
_UNSEEN, _UNSEEN_M = 3.0, 0.01  # cost of a line that ends beside pixels without depth, by so much or more
_TRIED = 8  # best lines that are looked at first, then twice as many at a time, until none of them ends there
_DEEP, _DEEPER_M = 3.0, 0.01  # cost of a line whose object is deeper than the hand, by so much or more
_RAISED_M = 0.1  # of a line over the height at which it would be best held
_BIAS = 10.0  # [1/m] of one side of the centre over the other, which decides where both are alike
_MOST_COST = 5.0  # of a line that the hand cannot execute, for its neighbours
_BINOMIAL = np.array([0.0625, 0.25, 0.375, 0.25, 0.0625])
_SOFT = 0.15  # of the cost, in which the weight of a line falls by a factor of e
_CELL_M = 0.006  # of which the means are the points of the object that the hand must not meet
_SAME_M = 0.005  # a line with both ends nearer to those of a refused one is refused, too
_LEAST_M, _MORE_M = -0.002, 0.004  # of clearance, below which a hand does not come, and above which more is of no use
_TIGHT = 1.0  # cost of a line with the least clearance at its best angle
_SCARCE_DEG = 100.0  # of tilting that the least clearance is worth; half of it is worth a quarter
_OTHER_THUMB_DEG = (
    80.0  # of tilting, for which the thumb of a hand with a palm takes the contact on the left of the image
)
_OTHER_SIDE_DEG = 1.0  # of tilting, for which the palm comes from the other side
_NEAR_DEG = 4.0  # of tilting, in which the weight of an angle beside the best falls by a factor of e
COMPLETED_POINTS = 2500  # of an object that are used; more change few grasps
SCORE_OF_NONE = 10.0  # score of a line without any cost

_ANGLE = np.pi * np.arange(_ANGLES) / _ANGLES  # (24,) [rad]
_OFFSET: Float64 = _STEP_M * (np.arange(_LINES, dtype=np.float64) - _LINES // 2)  # (17,) [m]
_PLACE_COST = (_OFFSET / _DISTANCE_M) ** 2 + _ACROSS * np.abs(np.cos(_ANGLE))[:, None] + _BIAS * _OFFSET
_TURNS, _STEPS = np.meshgrid(np.arange(-_NEAR, _NEAR + 1), np.arange(-_NEAR, _NEAR + 1), indexing="ij")
# Means with two neighbours on either side: of the directions, with two of the other end before and after; of the places, whose last ones repeat.
_MEAN_OF_ANGLES = np.stack([np.pad(_BINOMIAL, (k, _ANGLES - 1 - k)) for k in range(_ANGLES)])
_MEAN_OF_LINES = np.stack([np.pad(_BINOMIAL, (k, _LINES - 1 - k)) for k in range(_LINES)], axis=1)
_MEAN_OF_LINES = np.concatenate(
    [_MEAN_OF_LINES[:3].sum(axis=0)[None], _MEAN_OF_LINES[3:-3], _MEAN_OF_LINES[-3:].sum(axis=0)[None]]
)


@dataclass(frozen=True, eq=False)
class ClosingLines:
    """The lines of one object. Arrays are (24, 17): directions, and places beside the centre."""

    # (24, 17, 2, 3) float64 [m], both ends by which lines are compared, camera frame; they lie inside of the object (see `_END_SHARE`). The first is
    # on the side that `PREFERRED` leaves. NaN where the line meets nothing
    ends: Float64
    outer: Float64  # (24, 17, 2) float64 [m], places on the line where the object ends
    height: Float64  # float64 [m], above the table
    blocker: Int64  # int64, index of the first obstacle in the way of a finger, or -1
    cost: Float64  # float64, infinite for lines that the hand cannot execute
    counts: dict[str, int]  # of lines: all, and those refused by each filter
    lost: float  # by which the best cost is higher than it would be without obstacles; infinite if they block all


class CompletedObject:
    """An object on its table with its unseen side estimated.

    Args:
        points: Its visible points, camera frame, with weights.
        spacing: (N,) float32 [m], distance of each point to its neighbours.
        plane: The table.
        hand: What the hand can execute.
        obstacles: What stands around.
        shift: (3,) float64 [m], of the grasps, in the camera's frame.
        neighbours: How many the distances in `spacing` are the mean of.
        outline: Its outline in the image; None where the image is not known.

    Raises:
        CloudError: If no point has a weight.
    """

    def __init__(
        self,
        points: WeightedPoints,
        spacing: Float32,
        plane: Plane,
        hand: HandConfig,
        obstacles: Obstacles | None,
        shift: Float64,
        neighbours: int,
        outline: SeenOutline | None = None,
    ) -> None:
        self._hand, self._outline = hand, outline
        # Of an even grid with such distances; on average, an outline lies half a step beyond the outermost points.
        self._step_m = _quantile(spacing, _UPRIGHT) / (2.0 / 3.0 * np.sqrt(neighbours / np.pi))
        self._obstacles = obstacles
        self.has_palm = hand.hand.limits_depth
        self._points, self._spacing = points, spacing
        total = float(points.inlier.sum())
        if not total > 0.0:
            raise CloudError(f"xyz: none of {len(points.xyz)} points is near others")
        centroid = points.inlier @ points.xyz / total
        # Without a viewpoint in front of all points, nothing is known to be unseen.
        self._in_view = bool((points.xyz[:, 2] > 0.05 * float(np.linalg.norm(centroid))).all())
        self._basis = _table_basis(plane, centroid, self._in_view)
        up = self._basis[2]
        height = float(plane.normal @ centroid + plane.offset) * (1.0 if plane.normal @ up > 0.0 else -1.0)
        height -= _base(height + _quantile((points.xyz - centroid) @ up, _END_SHARE))
        self._foot = centroid - height * up
        seen = (points.xyz - self._foot) @ self._basis.T
        eye = -self._foot @ self._basis.T
        self._horizontal = float(np.hypot(eye[0], eye[1]) / max(np.linalg.norm(eye), 1e-9)) if self._in_view else 1.0
        n = len(seen)
        shift = self._basis @ shift
        result = np.empty(3)
        xyz, weights = np.empty((2 * n, 3)), np.empty(2 * n)
        heights = seen[points.inlier > 0.5, 2]
        top = _quantile(heights, 1.0 - _END_SHARE) if len(heights) else np.nan
        _complete_object(seen, points.inlier, n, top, shift, self._view, xyz, weights, result)
        size = int(result[0])
        if size < 0:
            raise CloudError("xyz: the points of the object are too far apart")
        self.n_completed = size - n
        self._xyz = xyz[:size]
        self._weights = weights[:size]
        self._foot, self._shift_m = self._foot + np.append(result[1:], 0.0) @ self._basis, float(shift[2])
        del self._view  # of the frame before

    @cached_property
    def _seen(self) -> tuple[Float64, Float32, Float32]:
        """A grid over the object's image: column, row and pitch; and as `outline` finds them, `nearest` [m] and `inside`."""
        x, y, z = self._points.xyz.T.copy()  # reductions along rows of three are slow
        pitch = max(_PITCH, _SPACINGS * median(self._spacing / z))
        columns, rows = x / z, y / z
        grid = np.array([columns.min() - 4.0 * pitch, rows.min() - 4.0 * pitch, pitch])
        shape = int((rows.max() - grid[1]) / pitch) + 5, int((columns.max() - grid[0]) / pitch) + 5
        nearest, inside = np.empty(shape, np.float32), np.empty(shape, np.float32)
        _outline(self._points.xyz, len(z), grid, *shape, nearest, inside)
        if np.isnan(inside[0, 0]):
            raise MemoryError("outline")
        return grid, nearest, inside

    @cached_property
    def _view(self) -> Any:
        """The outline in the image and the present pose of the table's frame in the camera's, as the kernels read them.

        It has no cells if nothing is known to be unseen.
        """
        camera, per_cell = np.zeros(15), 0.0
        nearest = inside = np.empty((0, 0), np.float32)
        if self._in_view:
            grid, nearest, inside = self._seen
            camera, per_cell = np.concatenate([self._basis.T.ravel(), self._foot, grid]), 1.0 / grid[2]
        rows, columns = nearest.shape
        return struct(
            "Outline", camera=camera, nearest=nearest, inside=inside, rows=rows, columns=columns, per_cell=per_cell
        )

    def _close(self, turns: Float64, n_lines: int) -> Float64:
        """Return (A, n_lines, 10) float64, what `closing_lines` finds for (A, 2) directions [rad] and places beside the centre [m]."""
        hand, others = self._hand, self._others
        floor_m, way_m = hand.tip_radius + hand.clearance_m, hand.approach_m + hand.tip_radius
        settings = np.array(
            [_STEP_M, hand.tip_radius, floor_m, _END_SHARE, self._horizontal, self._shift_m, way_m, _OUTER_SHARE]
        )
        palm = hand.hand.palm if self.has_palm else np.zeros(2)
        n_tilts = len(TILTS) if self.has_palm else 0
        measured = np.empty((len(turns), n_lines, 10))
        _closing_lines(
            *(self._xyz, self._weights, len(self._xyz), turns, len(turns), n_lines, settings, self._view),
            *(others, len(others), palm, n_tilts, (len(palm) - 2) // 2 - n_tilts, measured),
        )
        return measured

    def lines(self) -> ClosingLines:
        """Return all closing lines with their costs."""
        turns = np.zeros((_ANGLES, 3))
        turns[:, 0], turns[:, 2] = _ANGLE, np.nan
        measured = np.ascontiguousarray(np.moveaxis(self._close(turns, _LINES), 2, 0))
        height, blocker = measured[[2, 4]]
        slope, width = _slopes(measured[:2]), self._width(measured)
        if self._hand.hand.is_jaw:  # which ends by single points
            known = np.isfinite(width)
            width = np.where(
                known, _smoothed(np.where(known, width, 0.0)) / np.maximum(_smoothed(1.0 * known), 1e-9), np.nan
            )
        refused = self._refused(measured, width)
        left = alone = np.isfinite(height)
        counts = {"n_lines": int(np.count_nonzero(left))}
        for name in REASONS:
            counts[name] = int(np.count_nonzero(left & refused[name]))
            alone, left = left, left & ~refused[name]
        counts["n_too_deep"] = 0
        counts["n_free"] = int(np.count_nonzero(left))
        every = _bounded(np.nan_to_num(self._cost(measured, slope, width), nan=np.inf))
        cost, lost = _final(every, left, refused["n_too_wide"]), 0.0
        if counts["n_blocked"]:
            lost = float(cost.min() - _final(every, alone, refused["n_too_wide"]).min())
        outer, first = np.moveaxis(measured[8:], 0, -1), np.nan_to_num(blocker, nan=-1.0).astype(np.int64)
        ends = self._ends(self._directions[:, None], _OFFSET, np.moveaxis(measured[:2], 0, -1), height)
        return ClosingLines(ends, outer, height, first, cost, counts, lost)

    def beside_unseen(self, lines: ClosingLines, around: DepthAround) -> ClosingLines:
        """Return lines with what it costs to end beside pixels without depth: the best ones, and as many as that makes the best.

        Args:
            lines: The lines of the object.
            around: The depth image around it.
        """
        order = np.argsort(lines.cost, axis=None, kind="stable")[: lines.counts["n_free"]]
        more, size, ends_of = np.zeros(lines.cost.shape), _TRIED, lines.ends.reshape(-1, 2, 3)
        while len(order):
            chosen, order, size = order[:size], order[size:], 2 * size
            ends = ends_of[chosen]
            beyond = around.beside(ends[:, 0], ends[:, 1])
            if not beyond.any():
                break
            more.flat[chosen] = _UNSEEN * smoothstep(beyond, 0.0, _UNSEEN_M)
        return replace(lines, cost=lines.cost + more) if more.any() else lines

    def _refused(self, measured: Float64, width: Float64) -> dict[str, Bool]:
        """Return which lines (10, ...) of `_close` with their widths (...) the hand cannot execute, by the names of `REASONS`."""
        low, high, height, top, blocker = measured[:5]
        return {
            "n_too_flat": np.isnan(low) | (height > top + 0.5 * self._hand.tip_radius),
            "n_too_wide": width > self._hand.opening,
            "n_too_thin": high - low < _THIN_M,
            "n_blocked": blocker >= 0.0,
        }

    def _width(self, measured: Float64) -> Float64:
        """Return the width of lines (10, ...) of `_close` that counts for the opening: for jaws from one end of the object to the other, since they meet what is wider."""
        low, high = measured[8:] if self._hand.hand.is_jaw else measured[:2]
        return np.asarray(high - low + (self._step_m if self._hand.hand.is_jaw else 0.0), np.float64)

    def _cost(self, measured: Float64, slope: Float64, width: Float64) -> Float64:
        """Return what speaks against each line (10, ...) of `_close`, with the slopes of both ends (2, ...) and widths (...)."""
        low, high, _, _, _, solid, deeper, raised = measured[:8]
        cost = (high - low) / _WIDTH_M + ((np.degrees(np.arctan(slope)) / _SLOPE_DEG) ** 2).sum(axis=0)
        cost += _PLACE_COST + _HOLLOW * (1.0 - solid)
        cost += _DEEP * smoothstep(deeper, 0.0, _DEEPER_M) + (raised / _RAISED_M) ** 2
        opening_m, almost = self._hand.opening, _ALMOST_HAND if self.has_palm else _ALMOST
        return np.asarray(cost + _WIDE * smoothstep(width, almost * opening_m, opening_m), np.float64)

    def contacts(self, lines: ClosingLines, angle: int, line: int) -> Float64:
        """Return (2, 3) the contacts of a line [m], where the object ends, in the order of its ends.

        Args:
            lines: The lines of the object.
            angle: Number of its direction.
            line: Number of its place.
        """
        return self._contacts(
            self._directions[angle], _OFFSET[line], lines.outer[angle, line], float(lines.height[angle, line])
        )

    def refined(self, lines: ClosingLines, angle: int, line: int) -> Float64:
        """Return the contacts of the mean of a line and its neighbours, weighted by their costs; of the line itself if that is refused.

        Args:
            lines: The lines of the object.
            angle: Number of its direction.
            line: Number of its place.
        """
        half, rows = np.divmod(angle + _TURNS, _ANGLES)
        columns = np.where(half % 2 == 0, line + _STEPS, _LINES - 1 - (line + _STEPS))
        inside = (columns >= 0) & (columns < _LINES)
        cost = np.where(inside, lines.cost[rows, np.clip(columns, 0, _LINES - 1)], np.inf)
        weight = np.exp(-np.minimum((cost - lines.cost[angle, line]) / _SOFT, 700.0)) * np.isfinite(cost)
        around = 1.0 * np.isfinite(cost)
        heights = np.where(np.isfinite(cost), lines.height[rows, np.clip(columns, 0, _LINES - 1)], 0.0)
        weight /= weight.sum()
        turn = np.pi * (angle + float((weight * _TURNS).sum())) / _ANGLES
        beside_m = _STEP_M * (line - _LINES // 2 + float((weight * _STEPS).sum()))
        measured = self._close(np.array([[turn, beside_m, float((around * heights).sum() / around.sum())]]), 1)[0, 0]
        if any(refused.any() for refused in self._refused(measured, self._width(measured)).values()):
            return self.contacts(lines, angle, line)
        return self._contacts(self._axes(np.array(turn)), beside_m, measured[8:], float(measured[2]))

    def _contacts(self, axes: Float64, beside_m: float, outer: Float64, height: float) -> Float64:
        """Return the contacts of a line where the object ends by its points or by its outline, but no farther apart than the hand opens."""
        away = self._away(axes[0])  # an end that faces the camera is no outline
        low = float(outer[0]) - 0.5 * self._step_m * (1.0 - max(away, 0.0))
        high = float(outer[1]) + 0.5 * self._step_m * (1.0 - max(-away, 0.0))
        if self._outline is not None:
            origin = self._foot + beside_m * axes[1] + height * axes[2]
            (first, last), (share, other) = self._outline.ends(axes, origin, self._hand.tip_radius)
            if not np.isnan(first):
                low, high = first + share * (min(first, low) - first), last + other * (max(last, high) - last)
        beyond = max(high - low - (1.0 - 1e-9) * self._hand.opening, 0.0) / 2.0  # less than it, also rounded
        return self._ends(axes, np.array(beside_m), np.array([low + beyond, high - beyond]), np.array(height))

    @cached_property
    def _directions(self) -> Float64:
        """(24, 3, 3), see `_axes`, of all directions in which lines are compared."""
        return self._axes(_ANGLE)

    def _axes(self, turn: Float64) -> Float64:
        """Return (..., 3, 3) rows: along lines with these directions (...) [rad], beside them, and up; camera frame."""
        axes = np.empty((*turn.shape, 3, 3))
        c, s, (ahead, left, up) = np.cos(turn)[..., None], np.sin(turn)[..., None], self._basis
        axes[..., 0, :], axes[..., 1, :], axes[..., 2, :] = c * ahead + s * left, c * left - s * ahead, up
        return axes

    def _ends(self, axes: Float64, beside_m: Float64, between: Float64, height: Float64) -> Float64:
        """Return (..., 2, 3) ends of lines, which are `between` (..., 2) along them [m]; the first is on the left of the image."""
        along, beside, up = axes[..., 0, :], axes[..., 1, :], axes[..., 2, :]
        middle = self._foot + beside_m[..., None] * beside + height[..., None] * up
        ends = middle[..., None, :] + between[..., None] * along[..., None, :]
        first = (along @ PREFERRED >= 0.0)[..., None, None]
        return np.asarray(np.where(first, ends, ends[..., ::-1, :]), np.float64)

    @cached_property
    def _own(self) -> Float64:
        """(N, 3) points of the object, thinned, in the table's frame."""
        points = self._xyz[self._weights > 0.5].astype(np.float32)
        return cell_means(points, voxel_grid(points, _CELL_M)) if len(points) else np.empty((0, 3))

    @property
    def hidden(self) -> Float64:
        """(M, 3) float64 [m], points of the side that the camera does not see, as it is estimated, camera frame."""
        first = len(self._points.xyz)
        certain = self._weights[first:] > 0.5
        return np.asarray(self._foot + self._xyz[first:][certain] @ self._basis, np.float64)

    @cached_property
    def _others(self) -> Float64:
        """(M, 3) points of what stands around, in the table's frame."""
        if self._obstacles is None:
            return np.empty((0, 3))
        return np.ascontiguousarray((self._obstacles.xyz.astype(np.float64) - self._foot) @ self._basis.T)

    def tightness(self, way: WayIn) -> float:
        """Return what it costs that a hand with a palm has little room on its way in.

        Args:
            way: The way.
        """
        thumb_at = self._hand.thumb_at
        room_m = float((way.approaches if thumb_at == "either" else way.approaches[int(thumb_at == "g2")]).max())
        if not self.has_palm or room_m >= _MORE_M:
            return 0.0
        return _TIGHT * (1.0 - float(smoothstep(np.array(room_m), _LEAST_M, _MORE_M)))

    def way_in(self, g1: Float64, g2: Float64) -> tuple[WayIn | None, bool]:
        """Find how the hand comes to a grasp.

        Args:
            g1: (3,) float64, a contact [m], camera frame.
            g2: (3,) float64, the other one.

        Returns:
            The way, None where the hand cannot come; and whether only other objects prevent it.
        """
        hand = self._hand.hand
        middle = self._basis @ ((g1 + g2) / 2.0 - self._foot)
        across = self._basis @ (g2 - g1)
        width = float(np.hypot(across[0], across[1]))
        frame = np.array([[across[0], across[1], 0.0], [-across[1], across[0], 0.0], [0.0, 0.0, width]]) / width
        clearances, behind = np.full((2, len(TILTS)), UNLIMITED_M), np.zeros(len(TILTS))
        if self.has_palm:
            own, others = ((points - middle) @ frame.T for points in (self._own, self._others))
            clearances, behind = hand.clearance(width, own, others, float(middle[2]))
            clearances = clearances[::-1]
        allowed = clearances >= _LEAST_M
        if self._hand.thumb_at != "either":
            allowed[int(self._hand.thumb_at == "g1")] = False
        if not allowed.any():
            if not self.has_palm or not len(others):
                return None, False
            alone = hand.clearance(width, own, others[:0], float(middle[2]))[0]
            return None, bool((alone >= _LEAST_M).any())
        lack = np.maximum((_MORE_M - clearances) / (_MORE_M - _LEAST_M), 0.0) ** 2
        cost = np.abs(np.degrees(TILTS)) + _SCARCE_DEG * lack + _OTHER_SIDE_DEG * (TILTS < 0.0)
        cost[0 if self.has_palm else 1] += _OTHER_THUMB_DEG
        cost = np.where(allowed, cost, np.inf)
        thumb, best = np.unravel_index(np.argmin(cost), cost.shape)
        # Between the best angle and those next to it, so that noise does not decide.
        near = np.abs(TILTS - TILTS[best]) < 1.5 * TILTS[1]
        weight = near * np.exp(-np.minimum((cost[thumb] - cost[thumb, best]) / _NEAR_DEG, 700.0))
        angle, depth_m = np.array([TILTS, behind]) @ weight / weight.sum()
        at, pose = hand.at(width), np.eye(4)
        z = -(np.sin(angle) * frame[1] + np.cos(angle) * frame[2]) @ self._basis
        x = frame[0] @ self._basis * (1.0 if thumb else -1.0)
        pose[:3, :3], pose[:3, 3] = np.stack([x, cross(z, x), z], axis=1), (g1 + g2) / 2.0
        joints = tuple(joint.name for joint in hand.config.joints)
        name: Literal["g1", "g2"] = "g2" if thumb else "g1"
        at_most_m = self._width_at_most_m(g1, g2)
        way = WayIn(z, name, float(depth_m), clearances, pose @ at.tool, at.posture, joints, self._hand.name, at_most_m)
        return way, False

    def _width_at_most_m(self, g1: Float64, g2: Float64) -> float:
        """Return an upper bound of the object's width between two contacts, which holds for 95 % of first grasps [m]."""
        edges_m = _STEPS_OF_POINTS * self._step_m
        if self._outline is not None:
            edges_m = _PIXELS * self._outline.around.pixel_m(float(g1[2] + g2[2]) / 2.0)
        return float(np.linalg.norm(g2 - g1) + _HIDDEN * abs(self._away(g2 - g1)) + edges_m)

    def _away(self, along: Float64) -> float:
        """Return how far a vector (3,) goes away from the camera; 0 where that is not known."""
        return float(along @ self._foot) / float(np.linalg.norm(self._foot)) if self._in_view else 0.0

    def strain(self, grasp: Grasp, mass_kg: float, friction: float) -> float:
        """Compute how much friction a grasp needs to carry the object, over what it has (see `foretouch.grasp.carry`).

        Args:
            grasp: A grasp, camera frame.
            mass_kg: Of the object.
            friction: Coefficient between fingertips and object.
        """
        ends = (np.stack([grasp.g1, grasp.g2]) - self._foot) @ self._basis.T
        return strain(ends, self._xyz, self._weights, mass_kg, friction, self._hand.force_n)

    def nearest_line(self, grasp: Grasp) -> tuple[int, int]:
        """Find the direction and the place of the line that is closest to a grasp.

        Args:
            grasp: A grasp, camera frame.
        """
        across = self._basis @ (grasp.g2 - grasp.g1)
        angle = round(float(np.arctan2(across[1], across[0])) / np.pi * _ANGLES) % _ANGLES
        middle, turn = self._basis @ (grasp.midpoint - self._foot), np.pi * angle / _ANGLES
        beside = float(np.cos(turn) * middle[1] - np.sin(turn) * middle[0])
        return angle, int(np.clip(round(beside / _STEP_M) + _LINES // 2, 0, _LINES - 1))


def _bounded(cost: Float64) -> Float64:
    """Return costs that approach `_MOST_COST` from one less on, so that the order of bad lines stays."""
    least = _MOST_COST - 1.0
    return np.where(cost < least, cost, _MOST_COST - 1.0 / (1.0 + np.maximum(cost - least, 0.0)))


def _final(cost: Float64, left: Bool, wide: Bool) -> Float64:
    """Costs of the lines that are left, smoothed with those that are only too wide; infinite for the others."""
    return np.where(left, _smoothed(np.where(left | wide, cost, _MOST_COST)), np.inf)


def _smoothed(cost: Float64) -> Float64:
    """Costs averaged with those of two neighbours on every side, so that noise does not decide; half a turn reverses the places."""
    around = np.concatenate([cost[-2:, ::-1], cost, cost[:2, ::-1]])
    return np.asarray(_MEAN_OF_ANGLES @ around @ _MEAN_OF_LINES, np.float64)


def _table_basis(plane: Plane, centroid: Float64, in_view: bool) -> Float64:
    """Return (3, 3) float64, rows: away from the camera along the table, to its left, and up; directions of the camera's frame.

    Away is between the direction of view and the image's upward direction, which is defined also from straight above.
    """
    up = np.asarray(plane.normal, np.float64) / np.linalg.norm(plane.normal)
    side = -(up @ centroid) if in_view else up @ centroid + plane.offset  # the camera's, or that of the object itself
    if side < 0.0 or (side == 0.0 and up[1] > 0.0):
        up = -up
    away = centroid / max(float(np.linalg.norm(centroid)), 1e-9) - np.array([0.0, 1.0, 0.0])
    away = away - (away @ up) * up
    if np.linalg.norm(away) < 1e-3:
        away = np.eye(3)[np.argmin(np.abs(up))] - up[np.argmin(np.abs(up))] * up
    away /= np.linalg.norm(away)
    return np.stack([away, cross(up, away), up])


def _base(lowest_m: float) -> float:
    """Return the height on which an object stands [m]: the table, unless its lowest visible points are below or far above it."""
    return lowest_m if lowest_m < 0.0 or lowest_m > _FLOATING_M else 0.0


def _quantile(values: Floating, share: float) -> float:
    """Return a quantile that is one of the values, in a tenth of the time of np.quantile."""
    k = int(share * (len(values) - 1))
    return float(np.partition(values, k)[k])


def _slopes(ends: Float64) -> Float64:
    """Return the root mean square slope from (..., 17) ends of the lines to those of the second neighbours; 1 where one is unknown.

    A fitted line would hide a corner, whose two sides fall away from it.
    """
    slopes = np.full((2, *ends.shape), np.nan)
    slopes[0, ..., _NEAR:] = (ends[..., _NEAR:] - ends[..., :-_NEAR]) / (_NEAR * _STEP_M)
    slopes[1, ..., :-_NEAR] = slopes[0, ..., _NEAR:]
    squares = slopes * slopes
    slope = np.sqrt((squares[0] + squares[1]) / 2.0)
    return np.where(np.isnan(slope), 1.0, slope)


def best_grasps(completed: CompletedObject, lines: ClosingLines, count: int) -> list[tuple[Float64, WayIn, float]]:
    """Choose lines to which the hand can come, best first; each differs from all better ones by a contact.

    Lines to which it cannot are added to the counts `n_too_deep` and `n_blocked`. The contact of the thumb
    is g1, where touch models expect it.

    Args:
        completed: The object.
        lines: Its lines.
        count: Largest number of grasps.

    Returns:
        Contacts (2, 3) [m], way in and cost of each.
    """
    order = np.argsort(lines.cost, axis=None, kind="stable")[: lines.counts["n_free"]].tolist()[::-1]
    chosen: list[tuple[Float64, WayIn, float]] = []
    taken, refused = np.empty((0, 2, 3)), np.empty((0, 2, 3))
    tried: list[tuple[float, int, Float64, WayIn]] = []  # a heap by cost, with that of the way in
    while len(chosen) < count and (order or tried):
        if not order or (tried and tried[0][0] <= lines.cost.flat[order[-1]]):
            cost, number, ends, way = heappop(tried)
            own = lines.ends.reshape(-1, 2, 3)[number]
            if _near(own, taken, APART_M):
                continue
            if completed.has_palm and not chosen:
                refined = completed.refined(lines, *divmod(number, _LINES))
                better, _ = completed.way_in(*refined)
                ends, way = (ends, way) if better is None else (refined, better)
            if way.thumb_at == "g2":
                ends, way = ends[::-1], way.with_contacts_swapped()
            taken = np.concatenate([taken, own[None]])
            chosen.append((ends, way, cost))
            continue
        number = order.pop()
        own = lines.ends.reshape(-1, 2, 3)[number]
        if _near(own, taken, APART_M) or _near(own, refused, _SAME_M):
            continue
        refine = not (completed.has_palm or chosen)
        ends = (completed.refined if refine else completed.contacts)(lines, *divmod(number, _LINES))
        found, blocked = completed.way_in(*ends)
        if found is None:
            lines.counts["n_blocked" if blocked else "n_too_deep"] += 1
            refused = np.concatenate([refused, own[None]])
        else:
            heappush(tried, (float(lines.cost.flat[number]) + completed.tightness(found), number, ends, found))
    return chosen


def _near(ends: Float64, others: Float64, distance_m: float) -> bool:
    """Whether both ends (2, 3) are within a distance of the ends of one of (K, 2, 3) others."""
    return bool((np.linalg.norm(others - ends, axis=2).max(axis=1, initial=0.0) < distance_m).any())


def as_in_image(grasp: Grasp) -> tuple[Float64, Float64]:
    """Order the contacts of a grasp as `HandConfig.thumb_at` names them: g1 is left in the image.

    Args:
        grasp: A grasp, camera frame.
    """
    return (grasp.g1, grasp.g2) if (grasp.g2 - grasp.g1) @ PREFERRED >= 0.0 else (grasp.g2, grasp.g1)


def blocking_objects(lines: ClosingLines, obstacles: Obstacles | None) -> tuple[int, ...]:
    """Return the ids of the objects that block lines, ascending.

    Args:
        lines: The lines of an object.
        obstacles: What stood around it.
    """
    if obstacles is None:
        return ()
    return tuple(np.unique(obstacles.object_ids[lines.blocker[lines.blocker >= 0]]).tolist())


def why_no_line(lines: ClosingLines, hand: HandConfig, obstacles: Obstacles | None) -> str:
    """Return why the hand can execute none of the lines.

    Args:
        lines: The lines of an object.
        hand: The hand.
        obstacles: What stood around the object.
    """
    counts = lines.counts
    if counts["n_lines"] == 0:
        return "no horizontal line across the object meets 8 points"
    reasons = {
        "n_too_wide": f"wider than hand.opening_m {hand.opening:g}",
        "n_too_thin": f"shorter than {_THIN_M * 1e3:g} mm",
        "n_too_flat": "too low for a fingertip that keeps hand.clearance_m from the table",
        "n_blocked": f"blocked by object {', '.join(map(str, blocking_objects(lines, obstacles)))}",
        "n_too_deep": f"without a way in for hand.name {hand.name}: the object is deeper than its fingers",
    }
    parts = [f"{counts[name]} are {reason}" for name, reason in reasons.items() if counts[name]]
    return f"none of {counts['n_lines']} grasps can be executed: {'; '.join(parts)}"
