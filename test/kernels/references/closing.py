# SPDX-License-Identifier: Apache-2.0
"""What the kernels of `closing.c` and `hand.c` compute, in NumPy and in double."""

from typing import Any

import numpy as np
from scipy.ndimage import grey_closing

Array = np.ndarray[Any, Any]

HEIGHT_M, ALONG_M = float(np.float32(0.001)), float(np.float32(0.0005))  # of a bin of the two histograms
HEIGHTS, ALONGS = 640, 2560


def outline(points, n: int, grid, rows: int, columns: int, nearest, inside) -> None:
    """See the kernel, whose arguments these are."""
    at = (points[:n, :2] / points[:n, 2:] - grid[:2]) / grid[2]
    nearest[:] = np.inf
    np.minimum.at(nearest, tuple(np.floor(at[:, ::-1]).astype(int).T), points[:n, 2].astype(np.float32))
    tents = [
        np.maximum(1.0 - np.abs(at[:, k, None] - 0.5 - np.arange(size)), 0.0) for k, size in ((1, rows), (0, columns))
    ]
    filled = np.minimum(tents[0].T @ tents[1], 1.0)
    inside[:] = grey_closing(filled, size=(5, 5), mode="constant")


def outline_ends(points, n, own, image, frame, settings, rows, found, ends) -> None:
    """See the kernel, whose arguments these are; `image` is a mapping with points."""
    reach, tip, width, apart_m, steep = settings
    local = (points[:n].astype(np.float64) - frame[9:]) @ frame[:9].reshape(3, 3).T
    found[:], found[0] = np.nan, -1.0
    row = np.floor((local[:, 1] + reach) / width)
    counted = (np.abs(local[:, 1]) < reach) & (local[:, 2] > -tip)
    for k in range(rows):
        of_row = np.flatnonzero(counted & (row == k))
        for side, outermost in enumerate((np.argmin, np.argmax)) if len(of_row) else ():
            last = of_row[outermost(local[of_row, 0])]
            face = (np.abs(local[of_row, 2]) < tip / 2.0) & (np.abs(local[of_row, 0] - local[last, 0]) < 2.0 * width)
            mean = local[of_row[face], 0].mean() if face.any() else np.nan
            found[:, side, k] = last, local[last, 0], local[last, 1], mean
    last, along, beside, face = found[:, :, found[0, 0] >= 0.0]
    if not last.size:
        ends[:] = np.nan
        return
    outermost, outwards = points[last.astype(int)].astype(np.float64), np.array([[-1.0], [1.0]])
    step = outermost[..., 2].mean() / np.abs(image["camera"][::2]).mean()
    beyond = outermost[..., None, :] + np.arange(1.0, 4.0)[:, None] * step * outwards[..., None, None] * frame[:3]
    depth, pixels = _depths(image, beyond)
    outside = ~np.where(pixels < 0, False, own.reshape(-1)[pixels]).all(axis=-1)
    first, second = np.moveaxis(~(np.abs(np.diff(depth)) < apart_m + steep * step), -1, 0)
    middle = along + 0.5 * width * outwards * (1 + first * (1 + second))
    places = np.where(outside, middle, np.where(np.isnan(face), along, face))
    weight = 1.0 - np.abs(beside) / reach
    ends[:] = (np.stack([places, outside]) * weight).sum(axis=2) / weight.sum(axis=1)


def unseen_beyond(contacts, outwards, n, image, steps, settings, beyond) -> None:
    """See the kernel, whose arguments these are; `image` is a mapping with points."""
    step, behind, baseline, spare, pixels = settings
    way = contacts[:n, None] + np.arange(steps)[:, None] * step * outwards[:n, None]
    for k, (depth, z) in enumerate(zip(_depths(image, way)[0], way[..., 2], strict=True)):
        unseen, stop = np.isnan(depth), np.flatnonzero(np.isnan(depth) | (depth > z + behind))
        beyond[k] = 0.0
        if len(stop) and unseen[stop[0]]:
            first = stop[0]
            seen = np.flatnonzero(~unseen[first:]) + first
            last, far = (seen[0], depth[seen[0]]) if len(seen) else (steps, z[first])
            expected = baseline * abs(1.0 - z[first] / far) + spare + pixels * z[first] / image["camera"][0]
            beyond[k] = max((last - first) * step - expected, 0.0)


def _depths(image, places) -> tuple[Array, Array]:
    """Return depths and numbers of the pixels of places (..., 3): infinite and -1 out of view."""
    f_x, c_x, f_y, c_y = image["camera"]
    column = np.rint(places[..., 0] / places[..., 2] * f_x + c_x).astype(int)
    row = np.rint(places[..., 1] / places[..., 2] * f_y + c_y).astype(int)
    inside = (column >= 0) & (column < image["w"]) & (row >= 0) & (row < image["h"])
    pixels = np.where(inside, row * image["w"] + column, -1)
    return np.where(inside, image["xyz"].reshape(-1, 3)[pixels, 2], np.inf), pixels


def complete_object(points, weights, n, top, shift, seen, completed, shares, found) -> None:
    """See the kernel, whose arguments these are; `seen` is a mapping."""
    camera, nearest, inside, rows = (seen[name] for name in ("camera", "nearest", "inside", "rows"))
    xyz, weight, certain = points[:n], weights[:n], weights[:n] > 0.5
    if rows and not np.isnan(top):
        below = max(0.12 * top, 0.004)
        places, highest = _columns(points[:n][certain], 0.003)
        upper = _smooth(highest, top - 1.5 * below, top - 0.5 * below)
        middle = upper @ places / upper.sum()
        other = xyz * [-1.0, -1.0, 1.0] + np.append(2.0 * middle, 0.0)
        hidden = weight * _hidden(other, 0.004, camera, nearest, inside)
        xyz, weight = np.vstack([xyz, other[hidden > 0.0]]), np.concatenate([weight, hidden[hidden > 0.0]])
    places, highest = _columns(xyz[weight > 0.5] if (weight > 0.5).any() else xyz, 0.004)
    mass = np.maximum(highest, 1e-6)
    centre = mass @ places / mass.sum() + shift[:2]
    xyz = xyz - np.append(centre, 0.0)
    completed[: len(xyz)], found[:] = xyz, (len(xyz), *centre)
    shares[: len(xyz)] = np.where((np.abs(xyz[:, :2]) < 0.6).all(axis=1), weight, 0.0)


def _columns(xyz: Array, cell_m: float) -> tuple[Array, Array]:
    """Centres of the cells of a grid over the table with points, and the highest point of each."""
    cells, back = np.unique(np.floor(xyz[:, :2] / cell_m), axis=0, return_inverse=True)
    highest = np.full(len(cells), -np.inf)
    np.maximum.at(highest, back.reshape(-1), xyz[:, 2])
    return (cells + 0.5) * cell_m, highest


def closing_lines(points, weights, n, turns, angles, lines, settings, seen, others, m, palm, n_tilts, n_free, found):
    """See the kernel, whose arguments these are; of a hand without a palm."""
    assert n_free == 0
    camera, nearest, inside, rows = (seen[name] for name in ("camera", "nearest", "inside", "rows"))
    step, tip, floor_m, share, horizontal, shift, way, outer = settings
    found[:] = np.nan
    points, weights = points[weights > 0.0], weights[weights > 0.0]
    level = np.clip(points[:, 2] / HEIGHT_M, 0.0, HEIGHTS - 2.0)
    for angle, (turn, beside_m) in enumerate(turns[:, :2]):
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
            one = _Strip(place[strip], level[strip], weights[strip] * tent[strip])
            low, high, _ = one.ends(-np.inf, share)
            top, lowest = (_quantile(one.level, one.weight, q) * HEIGHT_M for q in (0.95, 0.03))
            level_m = top / 2.0
            if rows:
                along_m = ((low + high) / 2.0 - ALONGS / 2) * ALONG_M
                places = top * (1.0 - (np.arange(16) + 0.5) / 16)
                columns_m = [
                    (along_m + beside) * along_line + offset * beside_line + np.outer(places, [0.0, 0.0, 1.0])
                    for beside in (-tip / 2.0, 0.0, tip / 2.0)
                ]
                hidden = np.stack([_hidden(one, -0.003, camera, nearest, inside) for one in columns_m])
                hidden[:, :2] = 1.0
                level_m = float((hidden @ places).sum() / hidden.sum())
            width = (high - low) * ALONG_M
            if horizontal < 0.5 and top > 1.2 * width and width > 0.0:
                level_m = max(level_m, (top + _round_underside(one, top, lowest, low, high, horizontal)) / 2.0)
            z = max(level_m + shift, level_m / 2.0) if np.isnan(turns[angle, 2]) else turns[angle, 2]
            z = max(min(z, top - tip / 2.0), floor_m)
            if np.isnan(turns[angle, 2]):
                z = max(z - 0.006, floor_m)
            above = (z - tip) / HEIGHT_M
            low, high, total = one.ends(above, share)
            if total < 3.0:
                continue
            ends = (low - ALONGS / 2) * ALONG_M, (high - ALONGS / 2) * ALONG_M
            outer_ends = [(end - ALONGS / 2) * ALONG_M for end in one.ends(above, outer)[:2]]
            x, y, height = others[:m] @ along_line, others[:m] @ beside_line, others[:m, 2]
            outside = ((x > ends[0] - way) & (x < ends[0])) | ((x > ends[1]) & (x < ends[1] + way))
            blocking = np.flatnonzero((np.abs(y - offset) < tip) & (height > z - tip) & outside)
            solid = 1.0
            if rows:
                inset = min((ends[1] - ends[0]) / 2.0, 0.004)
                at = np.array([[ends[0] + inset], [ends[1] - inset]]) * along_line
                solid = _hidden(at + offset * beside_line + [0.0, 0.0, z], -0.003, camera, nearest, inside).mean()
            found[angle, line, :8] = (*ends, z, top, blocking[0] if len(blocking) else -1, solid, 0.0, 0.0)
            found[angle, line, 8:] = outer_ends


class _Strip:
    def __init__(self, place: Array, level: Array, weight: Array) -> None:
        self.place, self.level, self.weight = place, level, weight

    def ends(self, above: float, share: float) -> tuple[float, float, float]:
        """Ends along the line [bins] of the points above a height, which fade out over four bins, with a share beyond them; their weight."""
        weight = self.weight * np.clip((self.level - above) / 4.0 + 0.5, 0.0, 1.0)
        low, last = (_mean_quantile(bins, weight, share) for bins in (self.place, ALONGS - self.place))
        high = ALONGS - last
        beyond = 0.75 * share * (high - low)
        return max(low - beyond, 0.0), min(high + beyond, ALONGS - 1.0), weight.sum()


def _mean_quantile(values: Array, weight: Array, share: float) -> float:
    """Mean of the quantiles from half of a share to two and a half of it, each point spread over its bin of width 1."""
    reached = np.concatenate([[0.0], np.cumsum(np.bincount(np.ceil(values).astype(np.int64) - 1, weight))])
    total = reached[-1]
    if total == 0.0:
        return 0.0
    grid = np.linspace(0.5 * share, 2.5 * share, 4001)
    return float(np.interp(grid[:-1] + np.diff(grid) / 2.0, reached / total, np.arange(len(reached))).mean())


def _quantile(values: Array, weight: Array, share: float) -> float:
    """Interpolated within bins of width 1, of which each value fills two; the end of the last bin where there is no weight."""
    at = np.maximum(values - 0.5, 0.0)
    first, part = at.astype(np.int64), at % 1.0
    bins = np.bincount(np.r_[first, first + 1], np.r_[weight * (1.0 - part), weight * part])
    reached = np.cumsum(bins)
    inside = np.flatnonzero((bins > 0.0) & (reached >= share * reached[-1]))
    if not len(inside):
        return float(len(bins))
    k = inside[0]
    return float(k + (share * reached[-1] - reached[k] + bins[k]) / bins[k])


def _hidden(points: Array, depth: float, camera: Array, nearest: Array, inside: Array) -> Array:
    """How certainly the object hides places: inside of its outline, and behind the nearest point of the cell of the image."""
    seen = points @ camera[:9].reshape(3, 3).T + camera[9:12]
    with np.errstate(divide="ignore", invalid="ignore"):
        cell = np.floor((seen[:, :2] / seen[:, 2:] - camera[12:14]) / camera[14])
    rows, columns = nearest.shape
    met = (seen[:, 2] > 0.0) & (cell >= 0.0).all(axis=1) & (cell < [columns, rows]).all(axis=1)
    at = cell[met, 1].astype(int), cell[met, 0].astype(int)
    found = np.zeros(len(points))
    behind = np.where(np.isinf(nearest[at]), 1.0, seen[met, 2] - nearest[at].astype(np.float64))
    found[met] = inside[at] * _smooth(behind, depth - 0.002, depth + 0.002)
    return found


def _smooth(values, low: float, high: float):
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _round_underside(one: _Strip, top: float, lowest: float, low: float, high: float, horizontal: float) -> float:
    width = (high - low) * ALONG_M
    from_end, reach = 0.2 * (high - low), 0.15 * (high - low)
    shares = (
        np.clip(1.0 - np.abs(one.place - at) / reach, 0.0, None) * one.weight
        for at in (low + from_end, high - from_end)
    )
    side = max(share @ one.level / (share.sum() + 1e-9) for share in shares) * HEIGHT_M
    radius = width / 2.0
    below = lowest - (top - radius - radius * horizontal)
    evidence = (
        _smooth(top / width, 1.2, 1.5)
        * _smooth(below, -0.4 * radius, -0.1 * radius)
        * _smooth(top - side, 0.06 * radius, 0.22 * radius)
        * (1.0 - _smooth(horizontal, 0.3, 0.5))
    )
    return max(top - width, 0.0) * evidence


def hand_clearance(points, n, own, tilts, n_tilts, fronts, cells, sizes, clear, behind) -> None:
    """See the kernel, whose arguments these are."""
    per_cell, half, quarter, across = sizes[:4]
    x, beside, up = points[:n].astype(np.float32).T
    for k, tilt in enumerate(tilts[:n_tilts]):
        c, s = np.float32(np.cos(tilt)), np.float32(np.sin(tilt))
        z, y = -s * beside - c * up, s * up - c * beside
        rows, columns = (np.clip(v * np.float32(per_cell) + cells / 2, 0.5, cells - 0.5).astype(int) for v in (x, y))
        which = (np.arange(n) >= own).astype(int)
        between = (which == 0) & (np.abs(x) <= half) & (np.abs(y) <= across)
        left = np.where(between, z + np.where(np.abs(x) <= quarter, sizes[5], sizes[4]), 10.0)
        for row, front in enumerate((fronts[which, rows, columns], fronts[which, -1 - rows, -1 - columns])):
            clear[row, k] = np.minimum(z - front, left).min(initial=10.0)
        behind[k] = -np.where(between, z, 0.0).min(initial=0.0)
