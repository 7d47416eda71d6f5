# SPDX-License-Identifier: Apache-2.0
"""The outline of objects in the image: flying pixels off, feet on.

Flying pixels lie in the air between an object and what is behind it, since the camera mixed both. They are
recognised by having few neighbours at their own depth. Those next to solid pixels of the object are its
outline: they keep its label, but their depth is of neither surface, hence they are not solid.

What stands on the table of an organised cloud, one label an object.

Points above the plane are first labelled on a coarse grid of pixels. Two neighbours of the grid belong
together unless the pixels between them fall to the table or jump in depth, so that an object in front of
another one is not merged with it. The labels then grow to full resolution, and the outline is trimmed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import ClusterConfig, Clusters, HeightCut
from foretouch.cloud.segmentation.crop import CropConfig, in_range
from foretouch.cloud.segmentation.image_window import ImageWindow
from foretouch.types import Float32

__all__ = ["label_image", "trim_outline"]


Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]
Index = npt.NDArray[np.intp]

_FOOT = 1 / 3  # of the cut: from this height a pixel beside an object may be its foot
_SUPPORT = 4  # of eight neighbours at a pixel's own depth: a straight edge has 5, a flying pixel about 2
_STRAIGHT = 3  # of four directions in which a steep face goes on as it came


def trim_outline(labels: Int32, window: ImageWindow) -> Bool:
    """Take flying pixels from the labels and give them their feet, in place; tell which pixels are solid."""
    z = _bordered(window.z, np.nan)
    flying = _flying(labels, window, z)
    solid = labels > 0
    solid.reshape(-1)[flying] = False
    trusted = _bordered(labels * solid, 0)
    own = labels.take(flying)
    outline = np.zeros(len(flying), np.bool_)
    for neighbour in _neighbours(trusted, flying):
        outline |= neighbour == own
    labels.reshape(-1)[flying[~outline]] = 0
    feet, claimed = _feet(solid, window, z, trusted)
    labels.reshape(-1)[feet] = claimed
    solid.reshape(-1)[feet] = True
    return solid


def _flying(labels: Int32, window: ImageWindow, z: Float32) -> Index:
    """Labelled pixels, as flat indices, that lie in the air between two surfaces; `z` has a border of NaN."""
    # A cheap superset first: pixels beside any step that could be too much at the least depth.
    limit = window.near(np.fmin.reduce(window.z, axis=None, keepdims=True)).item()
    suspect = np.zeros(labels.shape, np.bool_)
    for image, mask in ((window.z, suspect), (window.z.T, suspect.T)):
        step = image[1:] - image[:-1]
        jump = np.abs(step, out=step) > limit
        mask[:-1] |= jump
        mask[1:] |= jump
    suspect &= labels > 0
    pixels = np.flatnonzero(suspect)
    own = window.z.take(pixels)
    near = window.near(own)
    steps = np.stack(list(_neighbours(z, pixels)))
    steps -= own
    support = np.count_nonzero(np.abs(steps) <= near, axis=0)
    # A steep face goes on as it came: opposite neighbours differ by the same step.
    straight = np.count_nonzero(np.abs(steps[:4] + steps[:3:-1]) <= near, axis=0)
    flying: Index = pixels[(support < _SUPPORT) & (straight < _STRAIGHT)]
    return flying


def _feet(solid: Bool, window: ImageWindow, z: Float32, trusted: Int32) -> tuple[Index, Int32]:
    """Low pixels that touch an object and lie at its depth: its foot is below the cut.

    Returns:
        Flat indices and the labels that claim them; `z` and `trusted` have a border of one pixel.
    """
    beside = solid.copy()
    beside[1:] |= solid[:-1]
    beside[:-1] |= solid[1:]
    wide = beside.copy()
    wide[:, 1:] |= beside[:, :-1]
    wide[:, :-1] |= beside[:, 1:]
    wide &= ~window.above
    pixels = np.flatnonzero(wide)
    own, height = window.z.take(pixels), window.height.take(pixels)
    cut = window.cut.at(own)
    low = (height > cut * np.float32(_FOOT)) & (height <= cut)
    pixels, own = pixels[low], own[low]
    near = window.near(own)
    claimed = np.zeros(len(pixels), np.int32)
    for owner, depth in zip(_neighbours(trusted, pixels), _neighbours(z, pixels), strict=True):
        claimed = np.where((owner > 0) & (np.abs(depth - own) <= near), owner, claimed)
    good = claimed > 0
    return pixels[good], claimed[good]


def _bordered(image: npt.NDArray[Any], value: float) -> npt.NDArray[Any]:
    """The image with a border of one pixel; np.pad takes ten times as long."""
    padded = np.full((image.shape[0] + 2, image.shape[1] + 2), value, image.dtype)
    padded[1:-1, 1:-1] = image
    return padded


def _neighbours(padded: npt.NDArray[Any], pixels: Index) -> Iterator[npt.NDArray[Any]]:
    """The eight neighbours of some pixels (n,), row by row; (n,) at a time.

    Args:
        padded: (h + 2, w + 2), the image with a border.
        pixels: Flat indices into the image without the border.
    """
    width = padded.shape[1]
    centre = pixels + 2 * (pixels // (width - 2)) + width + 1
    for step in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
        yield padded.take(centre + step)


def label_image(
    xyz: Float32, coarse: Float32, stride: int, crop: CropConfig, cut: HeightCut, config: ClusterConfig
) -> list[Clusters]:
    """Label an organised cloud.

    Args:
        xyz: (H, W, 3) float32 [m], camera optical frame.
        coarse: Every `stride`-th of its rows and columns, contiguous.
        stride: Of the coarse grid [px].
        crop: Depths that count.
        cut: What is table.
        config: What is one object.

    Returns:
        Labelled windows of the image, one around each patch that stands out. They may overlap as rectangles, but
        no pixel has a label in two of them. The labels still hold small clusters.
    """
    from scipy.ndimage import find_objects

    min_nodes = max(1, config.min_points // (2 * stride * stride))
    height, above = cut.measure(coarse, coarse[..., 2])
    patches = _patches(above & in_range(coarse[..., 2], crop), height > config.min_top_m, min_nodes)
    pitch = _pixel_pitch(coarse) / stride
    found: list[Clusters] = []
    taken = np.zeros(xyz.shape[:2], np.bool_)
    for number, box in enumerate(find_objects(patches), 1):
        rows, columns = (slice(max(span.start - 1, 0), span.stop + 1) for span in box)  # a margin of one cell
        part = tuple(slice(span.start * stride, span.stop * stride) for span in (rows, columns))
        z = np.ascontiguousarray(xyz[part][..., 2])
        height, above = cut.measure(xyz[part], z)
        above &= in_range(z, crop)
        window = ImageWindow(z, height, above, cut, stride, pitch, config)
        labels, solid, count = _label_window(window, patches[rows, columns] == number, min_nodes)
        labels *= ~taken[part]  # a foot may lie between two patches: the first has it
        solid &= labels > 0
        taken[part] |= solid
        found.append(Clusters(labels, solid, count, part[0].start, part[1].start))
    return found


def _label_window(window: ImageWindow, patch: Bool, min_nodes: int) -> tuple[Int32, Bool, int]:
    """Labels of one window, which pixels are solid, and the largest label."""
    with np.errstate(invalid="ignore"):  # pixels without depth compare as false
        nodes = _label_grid(window, patch, min_nodes)
        labels = _grow(nodes, window)
        solid = trim_outline(labels, window)
    return labels, solid, int(nodes.max(initial=0))


def _patches(above: Bool, tall: Bool, min_nodes: int) -> Int32:
    """Patches of the grid that stand out, numbered from 1, without what noise lifts: too small, or nowhere tall.

    Diagonal neighbours are of one patch, hence no cell of the grid touches two.
    """
    from scipy.ndimage import label

    labels = label(above, np.ones((3, 3)))[0]
    keep = np.bincount(labels.ravel()) >= min_nodes
    tops = np.zeros(len(keep), np.bool_)
    tops[labels[tall]] = True
    return _renumbered(labels, keep & tops)


def _renumbered(labels: Int32, keep: Bool) -> Int32:
    """Only the labels to keep, from 1 without gaps; the others are 0."""
    keep[0] = False
    return np.where(keep, np.cumsum(keep), 0).astype(np.int32)[labels]


def _pixel_pitch(xyz: Float32) -> float:
    """Lateral distance of horizontal neighbours per depth: 1/f of a pinhole camera; 0 if there are none."""
    rows = xyz[:: max(1, len(xyz) // 4)]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ray = rows[..., 0] / rows[..., 2]
        steps = np.abs(np.diff(ray, axis=1))
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if steps.size else 0.0


def _label_grid(window: ImageWindow, patch: Bool, min_nodes: int) -> Int32:
    """Components of one patch of the coarse grid, small ones dropped.

    Nodes and the links between them are drawn into an image of twice the size, whose 4-connected
    components are those of the graph.
    """
    from scipy.ndimage import label

    nodes = window.above[window.grid] & patch
    picture = np.zeros((2 * nodes.shape[0] - 1, 2 * nodes.shape[1] - 1), np.bool_)
    picture[::2, ::2] = nodes
    picture[1::2, ::2] = nodes[:-1] & nodes[1:] & _linked(window, axis=0)
    picture[::2, 1::2] = nodes[:, :-1] & nodes[:, 1:] & _linked(window, axis=1).T
    labels: Int32 = label(picture)[0][::2, ::2]
    return _renumbered(labels, np.bincount(labels.ravel()) >= min_nodes)


def _linked(window: ImageWindow, axis: int) -> Bool:
    """Whether grid neighbours along an axis are joined by a path of pixels without jump or table.

    Pixels without depth on the path say nothing; the ends may then differ by a single step only.

    Returns:
        The axis first: (rows - 1, columns) of the grid, or (columns - 1, rows).
    """
    stride = window.stride
    lines = (slice(None), slice(None, None, stride))
    z, height = ((part if axis == 0 else part.T)[lines] for part in (window.z, window.height))
    span = (len(z) - 1) // stride * stride
    z = z[: span + 1]
    below = height[: span + 1] <= window.cut.at(z)
    reach = window.reach(z[:-1])
    broken = np.abs(z[1:] - z[:-1]) > reach
    broken |= below[:-1]
    broken |= below[1:]
    allowed = np.where(_any(np.isnan(z[:-1]), stride), np.float32(1), np.float32(stride)) * reach[::stride]
    ends = z[::stride]
    result: Bool = (np.abs(ends[1:] - ends[:-1]) <= allowed) & ~_any(broken, stride)
    return result


def _any(steps: Bool, stride: int) -> Bool:
    """Whether any of each `stride` rows is true."""
    result: Bool = steps[::stride].copy()
    for i in range(1, stride):
        result |= steps[i::stride]
    return result


def _grow(nodes: Int32, window: ImageWindow) -> Int32:
    """The labels of the grid at full resolution.

    Pixels of a cell take the label of its corners. Where two objects meet in a cell, each pixel takes that of
    the labelled corner which is nearest in depth.
    """
    height, width = window.z.shape
    stride = window.stride
    corners = _corners(nodes)
    cells = corners.max(axis=0)
    shared = ((corners > 0) & (corners != cells)).any(axis=0)
    cells[shared] = -1
    labels: Int32 = np.repeat(np.repeat(cells, stride, axis=1), stride, axis=0)[:height, :width] * window.above
    if not shared.any():
        return labels
    contested = np.flatnonzero(labels < 0)
    rows, columns = np.divmod(contested, width)
    cell = rows // stride * nodes.shape[1] + columns // stride
    choices = corners.reshape(4, -1).take(cell, axis=1)
    apart = np.abs(_corners(window.z[window.grid]).reshape(4, -1).take(cell, axis=1) - window.z.take(contested))
    apart[(choices == 0) | np.isnan(apart)] = np.inf
    nearest = apart.argmin(axis=0) * len(contested) + np.arange(len(contested))
    labels.reshape(-1)[contested] = choices.take(nearest)
    return labels


def _corners(grid: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(4, h, w): for each cell of the grid (h, w) the values at its corners; the last row and column are repeated."""
    padded = np.empty((grid.shape[0] + 1, grid.shape[1] + 1), grid.dtype)
    padded[:-1, :-1] = grid
    padded[-1, :-1] = grid[-1]
    padded[:, -1] = padded[:, -2]
    return np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
