# SPDX-License-Identifier: Apache-2.0
"""What the kernel of `background.c` decides, in NumPy and SciPy: the reason of each part of a coarse grid, and the outline of the table."""

from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull

Array = np.ndarray[Any, Any]

STANDS, ENTERS, BEYOND, FLOATS, WALL = range(5)
_EIGHT = np.ones((3, 3), bool)
_SIDES = ((0, -1), (0, 1), (-1, 0), (1, 0))


def background(
    grid: Array, labels: Array, n: int, pitch: float, plane: Array, noise: float, **limits: float
) -> tuple[Array, Array]:
    """The reason of each label below n, and the corners of the outline as x / z and y / z."""
    level, below, border, floor, flat = (
        np.float32(limits[name]) for name in ("level", "below", "border", "foot", "flat")
    )
    normal, offset = plane[:3].astype(np.float32), np.float32(plane[3])
    height = grid[..., 0] * normal[0] + grid[..., 1] * normal[1] + grid[..., 2] * normal[2] + offset
    seen, part = np.isfinite(height), labels > 0
    low = np.abs(height) <= np.maximum(grid[..., 2] ** 2 * np.float32(noise), level)
    table = _table(seen & ~part & low, ~(seen & ~part & (height < -below)))
    rows, columns = (0, len(grid) - 1), _columns(seen)
    view = np.s_[rows[0] : rows[1] + 1, columns[0] : columns[1] + 1]
    outline = _hull(_ends(grid, table, rows, columns, 0.0))
    further = 0.3 * pitch * max(labels.shape)
    within = _within(_hull(_ends(grid, table, rows, columns, further)), grid, height, normal)
    counts, near, beside = _measured(grid, labels, n, height, table, view, floor)
    inside, cells, shallow = (
        np.array([np.count_nonzero(chosen[view] & seen[view] & (labels[view] == k)) for k in range(n)])
        for chosen in (within, part, height < floor)
    )
    reasons = np.zeros(n, int)
    for k in range(1, n):
        ring, at_border, raised, at_table, touching = counts[k]
        is_inside = 2 * inside[k] >= cells[k]
        hovers = 50 * at_border >= ring and 10 * raised >= 9 * at_border and 20 * touching < ring
        if not cells[k]:
            continue
        if hovers or at_border >= border * ring:
            reasons[k] = ENTERS if is_inside else BEYOND
        elif not is_inside:
            reasons[k] = BEYOND
        elif not (20 * at_table >= ring or 20 * shallow[k] >= cells[k]):
            reasons[k] = FLOATS
    _spread(reasons, counts, near, beside)
    within = _within_parts(labels, view) & seen
    _walls(reasons, grid, labels, cells, near, within, float(flat))
    _bin(reasons, grid, labels, height, near, within & part, plane[:3])
    return reasons, outline


def _table(table: Array, not_under: Array) -> Array:
    """The pieces of the table that are not noise, and between which the world below it is not seen."""
    pieces, count = ndimage.label(table, _EIGHT)
    if not count:
        return table
    sizes = np.bincount(pieces.ravel())[1:]
    kept = table & (100 * np.append(0, sizes) >= sizes.max())[pieces]
    linked, _ = ndimage.label(not_under, _EIGHT)
    return kept & (linked == linked.ravel()[np.flatnonzero(pieces.ravel() == sizes.argmax() + 1)[0]])


def _columns(seen: Array) -> tuple[int, int]:
    """The columns in view: without a narrow empty margin beside columns that are filled."""
    h, w = seen.shape
    filled = seen.sum(axis=0)
    some = np.flatnonzero(50 * filled >= h)
    if not len(some) or some[0] + 3 >= some[-1]:
        return 0, w - 1
    first, last = int(some[0]), int(some[-1])
    return (
        first if 8 * first < w and 2 * filled[first + 3] >= h else 0,
        last if 8 * (w - 1 - last) < w and 2 * filled[last - 3] >= h else w - 1,
    )


def _ends(grid: Array, table: Array, rows: tuple[int, int], columns: tuple[int, int], further: float) -> Array:
    """The first and last cell of the table in each row, and points beyond those at the border of the image."""
    rays = []
    for row in range(rows[0], rows[1] + 1):
        on = columns[0] + np.flatnonzero(table[row, columns[0] : columns[1] + 1])
        for column in on[[0, -1]] if len(on) else ():
            ray = grid[row, column, :2] / grid[row, column, 2]
            aside = int(column == columns[1]) - int(column == columns[0])
            along = int(row == rows[1]) - int(row == rows[0])
            rays += [ray, ray + further * np.array([aside, along])]
    return np.array(rays)


def _hull(rays: Array) -> Array:
    return rays[ConvexHull(rays).vertices]


def _within(hull: Array, grid: Array, height: Array, normal: Array) -> Array:
    """Whether the foot of each point is seen within a hull, whose corners are counter-clockwise."""
    foot = grid - height[..., None] * normal
    with np.errstate(invalid="ignore", divide="ignore"):
        u, v = foot[..., 0] / foot[..., 2], foot[..., 1] / foot[..., 2]
    inside = foot[..., 2] > 0
    for start, end in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        inside &= (end[0] - start[0]) * (v - start[1]) - (end[1] - start[1]) * (u - start[0]) >= 0
    return np.asarray(inside)


def _measured(
    grid: Array, labels: Array, n: int, height: Array, table: Array, view: tuple[slice, slice], floor: float
) -> tuple[Array, Array, Array]:
    """Edges around each part (n, 5): all, at the border, high ones there, at the table, close to it; between parts close ones and all."""
    counts, near, beside = np.zeros((n, 5), int), np.zeros((n, n), int), np.zeros((n, n), int)
    chosen = [image[view] for image in (labels, height, table, grid[..., 2])]
    padded = [np.pad(image, 1, constant_values=fill) for image, fill in zip(chosen, (-1, 0, 0, 0), strict=True)]
    label, high, on, z = padded
    cells = np.argwhere((label > 0) & np.isfinite(high))
    for side in _SIDES:
        for row, column in cells:
            k, other = label[row, column], (row + side[0], column + side[1])
            if label[other] == k:
                continue
            counts[k, 0] += 1
            if label[other] < 0:
                counts[k, 1:3] += 1, high[row, column] > floor
                continue
            close = abs(z[other] - z[row, column]) < 0.02
            counts[k, 3:] += bool(on[other]), bool(close and on[other])
            near[k, label[other]] += bool(close and label[other])
            beside[k, label[other]] += bool(label[other])
    return counts, near, beside


def _spread(reasons: Array, counts: Array, near: Array, beside: Array) -> None:
    """What rests on a part that stands does so, too; what is joined to one that enters the view, and not to the table, enters it."""
    changed = True
    while changed:
        changed = False
        for k in range(1, len(reasons)):
            if reasons[k] != FLOATS and (reasons[k] != STANDS or counts[k, 4]):
                continue
            reason = reasons[k]
            if near[k, reasons == ENTERS].sum() > near[k, reasons == STANDS].sum():
                reason = ENTERS
            elif reason == FLOATS and 20 * beside[k, reasons == STANDS].sum() >= counts[k, 0]:
                reason = STANDS
            changed |= bool(reason != reasons[k])
            reasons[k] = reason


def _within_parts(labels: Array, view: tuple[slice, slice]) -> Array:
    """Cells in view whose four neighbours are in view and have the same label."""
    padded = np.full((labels.shape[0] + 2, labels.shape[1] + 2), -1)
    padded[1:-1, 1:-1][view] = labels[view]
    centre = padded[1:-1, 1:-1]
    around = (padded[1 + dy : padded.shape[0] - 1 + dy, 1 + dx : padded.shape[1] - 1 + dx] for dy, dx in _SIDES)
    return np.logical_and.reduce([centre > 0, *(side == centre for side in around)])


def _sheet(points: Array) -> tuple[Array, Array, float]:
    """Middle, normal and variance of points on a plane, infinite if they are few."""
    if len(points) < 30:
        return np.zeros(3), np.zeros(3), np.inf
    values, vectors = np.linalg.eigh(np.cov(points.T.astype(float), bias=True))
    return points.mean(axis=0, dtype=float), vectors[:, 0], values[0]


def _walls(reasons: Array, grid: Array, labels: Array, cells: Array, near: Array, within: Array, flat: float) -> None:
    """A part in the plane of one beyond the table that it is joined to is a piece of the same wall."""
    for wall in np.flatnonzero(reasons == BEYOND):
        middle, normal, variance = _sheet(grid[(labels == wall) & within])
        for k in np.flatnonzero((reasons == STANDS) & (near[:, wall] > 0)):
            apart = np.abs((grid[labels == k] - middle) @ normal)
            if variance < flat**2 and 5 * np.count_nonzero(apart < 2 * flat) > 4 * cells[k]:
                reasons[k] = WALL


def _bin(reasons: Array, grid: Array, labels: Array, height: Array, near: Array, within: Array, normal: Array) -> None:
    """Upright sheets that meet or are equally high, or meet a wall, and what meets one of them and is as high."""
    tops, upright = np.zeros(len(reasons), np.float32), np.zeros(len(reasons), bool)
    for k in range(1, len(reasons)):
        tops[k] = np.nanmax(height, where=labels == k, initial=-np.inf)
        _, facing, variance = _sheet(grid[(labels == k) & within])
        along = np.cross(facing, normal)
        sine = np.linalg.norm(along)
        if reasons[k] == STANDS and tops[k] >= 0.05 and variance < 0.006**2 and sine**2 > 1 - 0.35**2:
            places = grid[labels == k].astype(float) @ along / sine
            upright[k] = np.nanmax(places) - np.nanmin(places) > 0.2
    level = np.abs(tops[:, None] - tops) < 0.005
    np.fill_diagonal(level, val=False)
    beyond = np.isin(reasons, (BEYOND, WALL))
    sides = np.where(upright, (near >= 2) | level, (near >= 2) & beyond).any(axis=1) & upright
    reasons[sides] = WALL
    while sides.any():
        sides = (reasons == STANDS) & ((near > 0) & level & (reasons == WALL)).any(axis=1)
        reasons[sides] = WALL
