# SPDX-License-Identifier: Apache-2.0
"""What the kernels of `closing.c` compute, in NumPy and in double."""

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

HEIGHT_M, ALONG_M = float(np.float32(0.001)), float(np.float32(0.0005))  # of a bin of the two histograms
HEIGHTS, ALONGS = 640, 2560


def hidden_points(points, n: int, depth: float, camera, nearest, rows: int, columns: int, hidden) -> None:
    """See the kernel, whose arguments these are."""
    behind = np.minimum(_behind(points[:n], camera, nearest if rows * columns else np.zeros((0, 0))), 1.0)
    hidden[:n] = _smooth(behind, 0.5 * depth, 1.5 * depth)


def closing_lines(points, weights, n, turns, angles, lines, settings, camera, nearest, rows, columns, others, m, found):
    """See the kernel, whose arguments these are."""
    step, tip, floor_m, share, horizontal, shift, way = settings
    found[:] = np.nan
    points, weights = points[weights > 0.0], weights[weights > 0.0]
    level = np.clip(points[:, 2] / HEIGHT_M, 0.0, HEIGHTS - 1.0)
    for angle, (turn, beside_m) in enumerate(turns):
        along_line = np.array([np.cos(turn), np.sin(turn), 0.0])
        beside_line = np.array([-np.sin(turn), np.cos(turn), 0.0])
        place = np.clip(points @ along_line / ALONG_M + ALONGS / 2, 0.0, ALONGS - 1.0)
        apart = points @ beside_line / step
        for line in range(lines):
            offset = beside_m + (line - (lines - 1) // 2) * step
            tent = 1.0 - 0.5 * np.abs(apart - offset / step)
            strip = tent >= 0.0
            if strip.sum() < 8:
                continue
            one = _Strip(place[strip], level[strip], weights[strip] * tent[strip], share)
            low, high, _ = one.ends(-np.inf)
            top, lowest = (_quantile(one.level, one.weight, q) * HEIGHT_M for q in (0.95, 0.03))
            middle = ((low + high) / 2.0 - ALONGS / 2) * ALONG_M * along_line + offset * beside_line
            levels = top * (1.0 - np.arange(2, 25) / 24)
            free = _behind(middle + levels[:, None] * [0.0, 0.0, 1.0], camera, nearest) < -0.003
            under = levels[free.argmax()] if rows and free.any() else 0.0
            width = (high - low) * ALONG_M
            if horizontal < 0.5 and top > 1.2 * width and width > 0.0:
                under = max(under, _round_underside(one, top, lowest, low, high, horizontal))
            z = max(min((top + under) / 2.0 + shift, top - tip / 2.0), under, floor_m)
            low, high, total = one.ends((z - tip) / HEIGHT_M)
            if total < 3.0:
                continue
            ends = (low - ALONGS / 2) * ALONG_M, (high - ALONGS / 2) * ALONG_M
            x, y, height = others[:m] @ along_line, others[:m] @ beside_line, others[:m, 2]
            outside = ((x > ends[0] - way) & (x < ends[0])) | ((x > ends[1]) & (x < ends[1] + way))
            blocking = np.flatnonzero((np.abs(y - offset) < tip) & (height > z - tip) & outside)
            found[angle, line] = (*ends, z, top, blocking[0] if len(blocking) else -1, total)


class _Strip:
    def __init__(self, place: Array, level: Array, weight: Array, share: float) -> None:
        self.place, self.level, self.weight, self._share = place, level, weight, share

    def ends(self, above: float) -> tuple[float, float, float]:
        """Quantiles along the line [bins] of the points above a height, which fade out over four bins; their weight."""
        weight = self.weight * np.clip((self.level - above) / 4.0 + 0.5, 0.0, 1.0)
        low, high = (_quantile(self.place, weight, q) for q in (self._share, 1.0 - self._share))
        return low, high, weight.sum()


def _quantile(values: Array, weight: Array, share: float) -> float:
    """Interpolated within bins of width 1; the end of the last bin with a point where there is no weight."""
    bins = np.bincount(values.astype(np.int64), weight)
    reached = np.cumsum(bins)
    inside = np.flatnonzero((bins > 0.0) & (reached >= share * reached[-1]))
    if not len(inside):
        return float(len(bins))
    k = inside[0]
    return float(k + (share * reached[-1] - reached[k] + bins[k]) / bins[k])


def _behind(points: Array, camera: Array, nearest: Array) -> Array:
    """Depth behind the nearest point of the cell of the image; infinite in a gap, -infinite outside of the outline."""
    inside = points @ camera[:9].reshape(3, 3).T + camera[9:12]
    with np.errstate(divide="ignore", invalid="ignore"):
        cell = np.floor((inside[:, :2] / inside[:, 2:] - camera[12:14]) / camera[14])
    rows, columns = nearest.shape
    seen = (inside[:, 2] > 0.0) & (cell >= 0.0).all(axis=1) & (cell < [columns, rows]).all(axis=1)
    found = np.full(len(points), -np.inf)
    depth = nearest[cell[seen, 1].astype(int), cell[seen, 0].astype(int)].astype(np.float64)
    found[seen] = np.where(depth == 0.0, -np.inf, np.where(np.isinf(depth), np.inf, inside[seen, 2] - depth))
    return found


def _smooth(values, low: float, high: float):
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _round_underside(one: _Strip, top: float, lowest: float, low: float, high: float, horizontal: float) -> float:
    at_end = 0.003 / ALONG_M
    width = (high - low) * ALONG_M
    sides = one.place < low + at_end, one.place > high - at_end
    end = max(_quantile(one.level[side], one.weight[side], 0.5) for side in sides) * HEIGHT_M
    radius = width / 2.0
    below = lowest - (top - radius - radius * horizontal)
    evidence = (
        _smooth(top / width, 1.2, 1.5)
        * _smooth(below, -0.4 * radius, -0.2 * radius)
        * _smooth(top - end, 0.25 * radius, 0.5 * radius)
        * (1.0 - _smooth(horizontal, 0.3, 0.5))
    )
    return max(top - width, 0.0) * evidence
