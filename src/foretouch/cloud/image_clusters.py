# SPDX-License-Identifier: Apache-2.0
"""What stands on the table of an organised cloud, one label an object.

Points above the plane are first labelled on a coarse grid of pixels. Two neighbours of the grid belong
together unless the pixels between them fall to the table or jump in depth, so that an object in front of
another one is not merged with it. The labels then grow to full resolution.

Flying pixels lie in the air between an object and what is behind it, since the camera mixed both. They are
recognised by having few neighbours at their own depth. Those next to solid pixels of the object are its
outline: they keep its label, but their depth is of neither surface, hence they are not `solid`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.clusters import ClusterConfig, Clusters, HeightCut
from foretouch.types import Float32

__all__ = ["label_image"]

Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]

_SUPPORT = 4  # of eight neighbours at a pixel's own depth: a straight edge has 5, a flying pixel about 2


class _Window(NamedTuple):
    """A part of the image, its upper left corner on the coarse grid."""

    z: Float32  # (h, w)
    above: Bool
    below: Bool
    reach: Float32  # (h, w), depth that neighbouring pixels may differ by [m]
    stride: int

    @property
    def coarse(self) -> tuple[slice, slice]:
        return (slice(None, None, self.stride), slice(None, None, self.stride))


def label_image(
    xyz: Float32, z: Float32, in_range: Bool, cut: HeightCut, config: ClusterConfig, stride: int
) -> Clusters | None:
    """Label an organised cloud.

    Args:
        xyz: (H, W, 3) float32 [m], camera optical frame.
        z: (H, W), its depths, contiguous.
        in_range: (H, W), pixels that count.
        cut: What is table.
        config: What is one object.
        stride: Of the coarse grid [px].

    Returns:
        The labelled part of the image, None where nothing stands out. The labels still hold small clusters.
    """
    grid = (slice(None, None, stride), slice(None, None, stride))
    above = cut.split(xyz[grid], z[grid])[0] & in_range[grid]
    if not above.any():
        return None
    part = _around(above, stride)
    high, low = cut.split(xyz[part], z[part])
    slope = np.float32(config.max_slope * _pixel_pitch(xyz[grid]) / stride)
    depth = np.ascontiguousarray(z[part])
    with np.errstate(invalid="ignore"):
        reach = np.maximum(depth * slope, np.float32(config.gap_m))
    window = _Window(depth, high & in_range[part], low, reach, stride)
    jumps = _jump(window, 0), _jump(window, 1)
    nodes = _label_grid(window, jumps, max(1, config.min_points // (4 * stride * stride)))
    labels = _grow(nodes, window)
    solid = _reject_flying(labels, window, jumps)
    return Clusters(labels, solid, int(nodes.max(initial=0)), part[0].start, part[1].start)


def _around(above: Bool, stride: int) -> tuple[slice, slice]:
    """The part of the image around all that stands out on the grid, with a margin of one cell."""
    spans = []
    for axis in (0, 1):
        hit = np.flatnonzero(above.any(axis=1 - axis))
        spans.append(slice(max(int(hit[0]) - 1, 0) * stride, (int(hit[-1]) + 2) * stride))
    return spans[0], spans[1]


def _pixel_pitch(xyz: Float32) -> float:
    """Lateral distance of horizontal neighbours per depth: 1/f of a pinhole camera; 0 if there are none."""
    rows = xyz[:: max(1, len(xyz) // 4)]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ray = rows[..., 0] / rows[..., 2]
        steps = np.abs(np.diff(ray, axis=1))
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if steps.size else 0.0


def _jump(window: _Window, axis: int) -> Bool:
    """Where the step to the next pixel along an axis is a jump in depth; no jump where one of both has none."""
    first, second = (window.z[:-1], window.z[1:]) if axis == 0 else (window.z[:, :-1], window.z[:, 1:])
    reach = window.reach[:-1] if axis == 0 else window.reach[:, :-1]
    with np.errstate(invalid="ignore"):
        result: Bool = np.abs(second - first) > reach
    return result


def _label_grid(window: _Window, jumps: tuple[Bool, Bool], min_nodes: int) -> Int32:
    """Components of the coarse grid, small ones dropped.

    Nodes and the links between them are drawn into an image of twice the size, whose 4-connected
    components are those of the graph.
    """
    from scipy.ndimage import label

    nodes = window.above[window.coarse]
    picture = np.zeros((2 * nodes.shape[0] - 1, 2 * nodes.shape[1] - 1), np.bool_)
    picture[::2, ::2] = nodes
    picture[1::2, ::2] = nodes[:-1] & nodes[1:] & _linked(window.stride, window.z, window.below, window.reach, jumps[0])
    transposed = (window.z.T, window.below.T, window.reach.T, jumps[1].T)
    picture[::2, 1::2] = nodes[:, :-1] & nodes[:, 1:] & _linked(window.stride, *transposed).T
    labels: Int32 = label(picture)[0][::2, ::2]
    sizes = np.bincount(labels.ravel())
    keep = sizes >= min_nodes
    keep[0] = False
    renumbered = np.where(keep, np.cumsum(keep), 0).astype(np.int32)
    return renumbered[labels]


def _linked(stride: int, z: Float32, below: Bool, reach: Float32, jump: Bool) -> Bool:
    """Whether grid neighbours along the first axis are joined by a path of pixels without jump or table.

    Pixels without depth on the path say nothing; the ends may then differ by a single step only.
    """
    span = (len(z) - 1) // stride * stride
    across = slice(None, None, stride)
    z, below = z[: span + 1, across], below[: span + 1, across]
    broken = jump[:span, across] | below[:-1] | below[1:]
    holes = ~np.isfinite(z[:-1])
    ends = z[::stride]
    step = reach[: span + 1 : stride, across][:-1]
    with np.errstate(invalid="ignore"):
        near = np.abs(ends[1:] - ends[:-1]) <= step * np.where(_any(holes, stride), np.float32(1), np.float32(stride))
    result: Bool = near & ~_any(broken, stride)
    return result


def _any(steps: Bool, stride: int) -> Bool:
    """Whether any of each `stride` rows is true."""
    result: Bool = steps[::stride].copy()
    for i in range(1, stride):
        result |= steps[i::stride]
    return result


def _grow(nodes: Int32, window: _Window) -> Int32:
    """The labels of the grid at full resolution.

    A cell whose four corners agree takes their label; in other cells each pixel takes that of the labelled
    corner which is nearest in depth, if one is near enough.
    """
    height, width = window.z.shape
    stride = window.stride
    corners = _corners(nodes)
    cells = np.where((corners == corners[0]).all(axis=0), nodes, np.int32(-1))
    labels = np.repeat(np.repeat(cells, stride, axis=1), stride, axis=0)[:height, :width]
    labels = np.multiply(labels, window.above)
    undecided = np.flatnonzero(labels < 0)
    rows, columns = np.divmod(undecided, width)
    cell = rows // stride * nodes.shape[1] + columns // stride
    choices = corners.reshape(4, -1).take(cell, axis=1)
    apart = _corners(window.z[window.coarse]).reshape(4, -1).take(cell, axis=1)
    apart -= window.z.take(undecided)
    np.abs(apart, out=apart)
    with np.errstate(invalid="ignore"):
        possible = (choices > 0) & (apart <= stride * window.reach.take(undecided))
    apart[~possible] = np.inf
    nearest = apart.argmin(axis=0) * len(undecided) + np.arange(len(undecided))
    labels.reshape(-1)[undecided] = np.where(possible.take(nearest), choices.take(nearest), 0)
    return labels


def _corners(grid: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(4, h, w): for each cell of the grid (h, w) the values at its corners; the last row and column are repeated."""
    padded = np.pad(grid, ((0, 1), (0, 1)), mode="edge")
    return np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])


def _reject_flying(labels: Int32, window: _Window, jumps: tuple[Bool, Bool]) -> Bool:
    """Take labels from pixels in the air, in place, and tell which labelled pixels are solid."""
    solid = labels > 0
    suspect = np.zeros(labels.shape, np.bool_)
    for side in (np.s_[:-1], np.s_[1:]):
        suspect[side] |= jumps[0]
        suspect[:, side] |= jumps[1]
    pixels = np.flatnonzero(suspect & solid)
    z, reach = window.z.take(pixels), window.reach.take(pixels)
    with np.errstate(invalid="ignore"):
        support = sum(np.abs(near - z) <= reach for near in _neighbours(window.z, np.float32(np.nan), pixels))
    pixels = pixels[support < _SUPPORT]
    solid.reshape(-1)[pixels] = False
    own = labels.take(pixels)
    outline = np.zeros(len(pixels), np.bool_)
    for near in _neighbours(labels * solid, np.int32(0), pixels):
        outline |= near == own
    labels.reshape(-1)[pixels[~outline]] = 0
    return solid


def _neighbours(
    image: npt.NDArray[Any], border: np.generic, pixels: npt.NDArray[np.intp]
) -> Iterator[npt.NDArray[Any]]:
    """The eight neighbours of some pixels (n,), given as flat indices; (n,) at a time."""
    width = image.shape[1] + 2
    padded = np.pad(image, 1, constant_values=border)
    rows, columns = np.divmod(pixels, image.shape[1])
    centre = (rows + 1) * width + columns + 1
    for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
        yield padded.take(centre + step)
