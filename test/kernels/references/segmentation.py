# SPDX-License-Identifier: Apache-2.0
"""What the kernels of `crop.c`, `plane.c` and `clusters.c` compute, in NumPy and SciPy. Float32 stays float32."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage

from foretouch.cloud.segmentation.clusters import CLOSE_SLOPE, FLYING_SLOPE, MAX_SLOPE, Clusters, in_range, pixel_pitch
from foretouch.cloud.segmentation.objects import Candidate
from foretouch.types.camera import DepthImage

Array = np.ndarray[Any, Any]


def count_range(source, crop) -> tuple[int, int]:
    xyz = _points(source)
    return np.count_nonzero(np.isfinite(xyz[..., 2])), np.count_nonzero(in_range(xyz[..., 2], crop))


def every(source, stride: int, crop) -> tuple[Array, Array]:
    xyz = _points(source)
    coarse = np.ascontiguousarray(xyz[::stride, ::stride])
    return coarse, np.flatnonzero(in_range(coarse[..., 2], crop))


def _points(source) -> Array:
    return source.points() if isinstance(source, DepthImage) else source


def counts(distance, offsets, reach) -> Array:
    return np.count_nonzero(np.abs(distance + offsets[:, None]) < np.float32(reach), axis=1)


def near(points, along, offset, reach) -> Array:
    return points[np.abs(along + offset) < reach]


def residuals(points, along, offset, reach, depth_m) -> tuple[Array, int]:
    residual, depth = along + offset, points[:, 2] + depth_m
    inside = np.abs(residual) < reach
    scaled = residual / np.maximum(depth * depth, 1e-4)
    return scaled[inside], np.count_nonzero(np.abs(residual) < 3.0 * reach)


def _heights(plane, xyz) -> Array:
    a, b, c, d = plane
    return xyz[..., 0] * a + xyz[..., 1] * b + xyz[..., 2] * c + d


def candidates(flat, number: int, window, width: int, plane) -> Iterator[Candidate]:
    """The solid points of each label, as `foretouch.cloud.segmentation.objects` names their facts."""
    h, w = window.labels.shape
    at = (np.arange(h) + window.rows)[:, None] * width + np.arange(w) + window.columns
    for label in range(1, window.n_labels + 1):
        pixels = at[window.solid & (window.labels == label)]
        if len(pixels):
            part = flat.take(pixels)
            columns = part.xyz.T.astype(np.float64, order="C")
            bounds = np.stack([columns.min(axis=1), columns.max(axis=1)])
            top = _heights(plane.coefficients.astype(np.float32), part.xyz).max()
            yield Candidate(part, columns.mean(axis=1), bounds, pixels, float(top), number, label)


def write_ids(image, window, ids) -> int:
    h, w = window.labels.shape
    new = ids[window.labels]
    part = image[window.rows : window.rows + h, window.columns : window.columns + w]
    part[new > 0] = new[new > 0]
    return np.count_nonzero(new)


def label_organised(xyz, grid, crop, threshold, config, rays=None, write=None) -> list[Clusters]:
    """Windows around the patches of the coarse grid, each labelled on the grid and then refined."""
    if write is not None:
        write(0, xyz.shape[0], 0, xyz.shape[1])
    coarse, stride, _ = grid
    min_nodes, pitch = max(1, config.min_points // (2 * stride * stride)), pixel_pitch(coarse) / stride

    def step(z, slope):
        return np.maximum(z * np.float32(slope * pitch), np.float32(config.gap_m))

    with np.errstate(invalid="ignore", over="ignore"):
        height, above = _measure(coarse, threshold, crop)
        _drop_beside(coarse, above, rays, 0, 0, stride, xyz.shape[1])
        patches = _kept(ndimage.label(above, np.ones((3, 3)))[0], min_nodes, height > np.float32(config.min_top_m))
        taken = np.zeros(xyz.shape[:2], bool)
        found = []
        for number, box in enumerate(ndimage.find_objects(patches), 1):
            rows, columns = (slice(max(one.start - 1, 0), one.stop + 1) for one in box)  # a margin of one cell
            part = tuple(slice(one.start * stride, one.stop * stride) for one in (rows, columns))
            points = xyz[part].copy()
            top, left = part[0].start, part[1].start
            everywhere = in_range(points[..., 2], crop)
            beside = _drop_beside(points, everywhere, rays, top, left, 1, xyz.shape[1])
            points[beside] = np.nan
            height, above = _measure(points, threshold, crop)
            z = points[..., 2]
            nodes = above[::stride, ::stride] & (patches[rows, columns] == number)
            below = height <= _least(threshold, z)
            edges = [_edges(nodes, z, below, stride, partial(step, slope=slope)) for slope in (CLOSE_SLOPE, MAX_SLOPE)]
            nodes = _join_small(_label_nodes(nodes, *edges[0]), *edges[1], 8 * min_nodes)
            nodes = _kept(nodes, min_nodes)
            labels = _grow(nodes, z, above, stride)
            solid = _refine(labels, z, height, above, threshold, lambda z: step(z, FLYING_SLOPE))
            labels[taken[part]] = 0  # base pixels may lie between two patches: they belong to the first
            solid &= labels > 0
            taken[part] |= solid
            found.append(Clusters(labels, solid, nodes.max(initial=0), top, left))
    return found


def _measure(xyz, threshold, crop) -> tuple[Array, Array]:
    height, z = _heights(threshold.plane.coefficients.astype(np.float32), xyz), xyz[..., 2]
    return height, (height > _least(threshold, z)) & (height < np.float32(threshold.high_m)) & in_range(z, crop)


def _least(threshold, z) -> Array:
    return np.maximum(z * np.float32(threshold.noise_per_m) * z, np.float32(threshold.low_m))


def _drop_beside(xyz, chosen, rays, top: int, left: int, stride: int, width: int) -> Array:
    """Unset and record the chosen points beside the ray of their pixel; all that are beside it."""
    if rays is None:
        return np.zeros_like(chosen)
    rows, columns = top + stride * np.arange(xyz.shape[0])[:, None], left + stride * np.arange(xyz.shape[1])
    beside = rays.beside(xyz, rows, columns)
    rays.dropped.append((rows * width + columns)[beside & chosen])
    chosen &= ~beside
    return beside


def _kept(labels, least: int, tall=None) -> Array:
    """Labels of at least some pixels, one of them tall, renumbered."""
    keep = np.bincount(labels.ravel()) >= least
    keep[0] = False
    if tall is not None:
        keep &= np.isin(np.arange(len(keep)), labels[tall])
    return np.where(keep, np.cumsum(keep), 0).astype(np.int32)[labels]


def _edges(nodes, z, below, stride: int, step: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Whether nodes are joined with those below them, and with those on their right."""
    down = nodes[:-1] & nodes[1:] & _joined(z, below, stride, step)
    return down, nodes[:, :-1] & nodes[:, 1:] & _joined(z.T, below.T, stride, step).T


def _label_nodes(nodes, down, right) -> Array:
    """Connected components of the grid; nodes and edges are drawn into an image of twice the size."""
    picture = np.zeros((2 * nodes.shape[0] - 1, 2 * nodes.shape[1] - 1), bool)
    picture[::2, ::2], picture[1::2, ::2], picture[::2, 1::2] = nodes, down, right
    return ndimage.label(picture)[0][::2, ::2]


def _join_small(labels, down, right, small: int) -> Array:
    """Components joined across further edges, in the order of their second nodes, where one of both is small."""
    sizes, names = np.bincount(labels.ravel()), np.arange(labels.max() + 1)
    ends = [(row + 1, column, row, column) for row, column in np.argwhere(down)]
    ends += [(row, column + 1, row, column) for row, column in np.argwhere(right)]
    for row, column, *other in sorted(ends):
        first, second = sorted((names[labels[row, column]], names[labels[tuple(other)]]))
        if first != second and min(sizes[first], sizes[second]) < small:
            sizes[first] += sizes[second]
            names[names == second] = first
    return names[labels]


def _joined(z, below, stride: int, step: Callable[[Array], Array]) -> Array:
    """Whether grid neighbours along the first axis are joined by pixels without a jump in depth or the table.

    If pixels between them have no depth, the ends may differ by a single step only.
    """
    span = (len(z) - 1) // stride * stride
    z, below = z[: span + 1, ::stride], below[: span + 1, ::stride]
    here, limit = z[:-1], step(z[:-1])

    def any_between(pixels):
        return pixels.reshape(span // stride, stride, z.shape[1]).any(axis=1)

    broken = any_between((np.abs(z[1:] - here) > limit) | below[:-1] | below[1:])
    allowed = np.where(any_between(np.isnan(here)), np.float32(1), np.float32(stride)) * limit[::stride]
    return ~broken & (np.abs(np.diff(z[::stride], axis=0)) <= allowed)


def _grow(nodes, z, above, stride: int) -> Array:
    """The label at the corners of a pixel's cell; if they differ, that of the corner which is nearest in depth."""

    def corners(grid):
        padded = np.pad(grid, ((0, 1), (0, 1)), mode="edge")
        four = np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
        return four.repeat(stride, axis=1).repeat(stride, axis=2)[:, : z.shape[0], : z.shape[1]]

    labels, apart = corners(nodes), np.abs(corners(z[::stride, ::stride]) - z)
    apart[(labels == 0) | np.isnan(apart)] = np.inf
    most = labels.max(axis=0)
    shared = ((labels > 0) & (labels != most)).any(axis=0)
    nearest = np.take_along_axis(labels, apart.argmin(axis=0)[None], axis=0)[0]
    return np.where(above, np.where(shared, nearest, most), 0).astype(np.int32)


def _refine(labels, z, height, above, threshold, step: Callable[[Array], Array]) -> Array:
    """Take flying pixels out and base pixels in, in place; returns which pixels are solid."""
    apart, near = _around(z, np.nan) - z, step(z)
    jump = (np.abs(apart[[1, 3, 4, 6]]) > step(np.fmin.reduce(z, axis=None))).any(axis=0)
    support = (np.abs(apart) <= near).sum(axis=0)  # neighbours at the pixel's own depth
    straight = (np.abs(apart[:4] + apart[:3:-1]) <= near).sum(axis=0)  # directions of one slope
    flying = (labels > 0) & jump & (support < 4) & (straight < 3)
    solid = (labels > 0) & ~flying
    around = _around(labels * solid, 0)
    labels[flying & ~(around == labels).any(axis=0)] = 0
    low = ~above & (height > _least(threshold, z) * np.float32(1 / 3)) & (height <= _least(threshold, z))
    owner = np.zeros_like(labels)
    for neighbour, distance in zip(around, np.abs(apart), strict=True):
        owner = np.where(low & (neighbour > 0) & (distance <= near), neighbour, owner)
    labels[owner > 0] = owner[owner > 0]
    return solid | (owner > 0)


def _around(image, outside: float) -> Array:
    """(8, h, w): the neighbours of each pixel, row by row."""
    h, w = image.shape
    padded = np.pad(image, 1, constant_values=outside)
    return np.stack([padded[i : i + h, j : j + w] for i in range(3) for j in range(3) if (i, j) != (1, 1)])
