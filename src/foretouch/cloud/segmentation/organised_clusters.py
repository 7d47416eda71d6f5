# SPDX-License-Identifier: Apache-2.0
"""Label the objects of an organised cloud by connected components in the image.

Points above the table are first labelled on a coarse grid of pixels. Two neighbours of the grid are connected unless
the pixels between them fall to the table or jump in depth, so that an object in front of another one is not merged
with it. The labels then grow to full resolution, and the outlines are refined:

- Flying pixels lie in the air between an object and its background, since the camera mixed both. They have few
  neighbours at their own depth. Those next to solid pixels of the object are its outline: they keep its label, but
  their depth belongs to neither surface, hence they are not solid.
- Base pixels are below the height threshold, touch an object and lie at its depth: they are the foot of the object.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import Bool, ClusterConfig, Clusters, HeightThreshold, Int32
from foretouch.cloud.segmentation.crop import CropConfig, in_range
from foretouch.cloud.segmentation.rays import RayFilter
from foretouch.kernels import Kernel
from foretouch.types import Float32

Index = npt.NDArray[np.intp]

_grid_patches = Kernel("grid_patches", *(np.float32, int, int, int, int, np.float64, np.int32, np.int64, np.int64))
_label_window = Kernel(
    "label_window",
    *(np.float32, int, int, int, int, int, np.int32, int, int, int, int),
    *(np.float64, int, int, int, np.uint8, np.int32, np.uint8, np.int64),
)

_BASE_FRACTION = 1 / 3  # of the height threshold: from this height a pixel beside an object may be its base
_SUPPORT = 4  # of eight neighbours at a pixel's own depth: a straight edge has 5, a flying pixel about 2
_STRAIGHT = 3  # of four directions in which a steep face continues with the same slope


class _Window(NamedTuple):
    """A part of the image whose upper left corner is on the coarse grid."""

    z: Float32  # (h, w) float32 [m]
    height: Float32  # (h, w) float32, above the table [m]
    above: Bool  # (h, w) bool, in range and above the height threshold
    threshold: HeightThreshold  # height threshold above the table
    stride: int  # step of the coarse grid [px]
    pitch: float  # lateral distance of neighbouring pixels per depth
    config: ClusterConfig  # settings

    @property
    def grid(self) -> tuple[slice, slice]:
        """The pixels of the coarse grid."""
        return (slice(None, None, self.stride), slice(None, None, self.stride))

    def connected_step(self, z: Float32) -> Float32:
        """Maximum depth difference of connected neighbours [m]."""
        return self._max_step(z, self.config.max_slope)

    def support_step(self, z: Float32) -> Float32:
        """Maximum depth difference of neighbours that support a pixel [m]."""
        return self._max_step(z, self.config.flying_slope)

    def _max_step(self, z: Float32, slope: float) -> Float32:
        step: Float32 = np.maximum(z * np.float32(slope * self.pitch), np.float32(self.config.gap_m))
        return step


def label_organised(
    xyz: Float32,
    coarse: Float32,
    stride: int,
    crop: CropConfig,
    threshold: HeightThreshold,
    config: ClusterConfig,
    rays: RayFilter | None = None,
) -> list[Clusters]:
    """Label an organised cloud.

    Args:
        xyz: (H, W, 3) float32 [m], camera optical frame.
        coarse: Every `stride`-th of its rows and columns, contiguous.
        stride: Step of the coarse grid [px].
        crop: Depth range.
        threshold: Height threshold above the table.
        config: Settings.
        rays: Drops and counts points beside the ray of their pixel, if given.

    Returns:
        Labelled windows of the image, one around each patch above the table. The rectangles may overlap, but
        no pixel has a label in two of them. Small clusters are not yet removed.
    """
    if _label_window and xyz.flags.c_contiguous and coarse.flags.c_contiguous:
        windows = _label_compiled(xyz, coarse, stride, crop, threshold, config, rays)
        if windows is not None:
            return windows
    from scipy.ndimage import find_objects

    min_nodes = _min_nodes(config, stride)
    height, above = threshold.measure(coarse, coarse[..., 2])
    above &= in_range(coarse[..., 2], crop)
    if rays is not None:
        above &= ~_off_grid(coarse, above, stride, rays, xyz.shape[1])
    patches = _patches(above, height > config.min_top_m, min_nodes)
    pitch = _pixel_pitch(coarse) / stride
    found: list[Clusters] = []
    taken = np.zeros(xyz.shape[:2], np.bool_)
    for number, box in enumerate(find_objects(patches), 1):
        rows, columns = (slice(max(span.start - 1, 0), span.stop + 1) for span in box)  # a margin of one cell
        part = tuple(slice(span.start * stride, span.stop * stride) for span in (rows, columns))
        points = xyz[part]
        z = np.ascontiguousarray(points[..., 2])
        if rays is not None:
            points, z = _on_rays(points, z, part, rays, xyz.shape[1], crop)
        height, above = threshold.measure(points, z)
        above &= in_range(z, crop)
        window = _Window(z, height, above, threshold, stride, pitch, config)
        with np.errstate(invalid="ignore", over="ignore"):  # pixels without depth compare as false
            nodes = _label_grid(window, patches[rows, columns] == number, min_nodes)
            labels = _grow(nodes, window)
            solid = _refine_outlines(labels, window)
        labels *= ~taken[part]  # base pixels may lie between two patches: they belong to the first
        solid &= labels > 0
        taken[part] |= solid
        found.append(Clusters(labels, solid, int(nodes.max(initial=0)), part[0].start, part[1].start))
    return found


def _min_nodes(config: ClusterConfig, stride: int) -> int:
    """Smallest number of pixels of the coarse grid that may belong to an object."""
    return max(1, config.min_points // (2 * stride * stride))


def _label_compiled(
    xyz: Float32,
    coarse: Float32,
    stride: int,
    crop: CropConfig,
    threshold: HeightThreshold,
    config: ClusterConfig,
    rays: RayFilter | None,
) -> list[Clusters] | None:
    """`label_organised` by kernels/clusters.c; None without memory."""
    image, grid = xyz.shape[:2], coarse.shape[:2]
    min_nodes, pitch = _min_nodes(config, stride), _pixel_pitch(coarse) / stride
    settings = np.array(
        [
            *threshold.plane.coefficients,
            *(threshold.low_m, threshold.noise_per_m, threshold.high_m, crop.min_range_m, crop.max_range_m),
            *(config.max_slope * pitch, config.flying_slope * pitch, config.gap_m, config.min_top_m),
            *([0.0] * 8 if rays is None else [1.0, *rays.numbers]),
        ]
    )
    patches, found = np.empty(grid, np.int32), np.empty(2, np.int64)
    boxes = np.empty((patches.size // min_nodes + 1, 4), np.int64)
    _grid_patches(coarse, *grid, stride, min_nodes, settings, patches, boxes, found)
    if found[0] < 0:
        return None
    if found[1] and rays is not None:
        rows, columns = np.nonzero(patches < 0)
        rays.record(stride * (rows * image[1] + columns))
    spans = boxes[: found[0]] + np.array([-1, 1, -1, 1])  # a margin of one cell
    spans = np.minimum(np.maximum(spans, 0) * stride, (image[0], image[0], image[1], image[1]))
    low, high = spans.min(axis=0, initial=max(image)), spans.max(axis=0, initial=0)
    marks = np.zeros((max(0, high[1] - low[0]), max(0, high[3] - low[2])), np.uint8)
    marked = (int(low[0]), int(low[2]), marks.shape[1], marks)
    windows: list[Clusters] = []
    any_beside = False
    for number, (top, bottom, left, right) in enumerate(spans.tolist(), 1):
        labels, solid = (
            np.empty((bottom - top, right - left), np.int32),
            np.empty((bottom - top, right - left), np.uint8),
        )
        rest = (grid[1], stride, number, min_nodes, settings, *marked, labels, solid, found)
        _label_window(xyz, image[1], top, left, *labels.shape, patches, *rest)
        if found[0] < 0:
            return None
        any_beside |= found[1] > 0
        windows.append(Clusters(labels, solid.view(np.bool_), int(found[0]), top, left))
    if any_beside and rays is not None:
        rows, columns = np.nonzero(marks & 2)
        rays.record((rows + low[0]) * image[1] + columns + low[2])
    return windows


def _off_grid(coarse: Float32, above: Bool, stride: int, rays: RayFilter, width: int) -> Bool:
    """(h, w) bool: pixels of the coarse grid above the table that are beside their ray."""
    off = np.zeros(above.shape, np.bool_)
    index = np.flatnonzero(above)
    points: Float32 = coarse.reshape(-1, 3).take(index, axis=0)
    rows, columns = np.divmod(index, above.shape[1])
    rows *= stride
    columns *= stride
    beside = rays.beside(points, points[:, 2], rows, columns)
    if beside.any():
        off.reshape(-1)[index[beside]] = True
        rays.record((rows * width + columns)[beside])
    return off


def _on_rays(
    points: Float32, z: Float32, part: tuple[slice, ...], rays: RayFilter, width: int, crop: CropConfig
) -> tuple[Float32, Float32]:
    """The points (h, w, 3) of a window and their depths, without those beside their ray: they become holes."""
    rows = np.arange(part[0].start, part[0].start + z.shape[0])
    columns = np.arange(part[1].start, part[1].start + z.shape[1])
    beside = rays.beside(points, z, rows[:, None], columns)
    if beside.any():
        row, column = np.nonzero(beside & in_range(z, crop))
        rays.record(rows[row] * width + columns[column])
        points, z = points.copy(), z.copy()
        points[beside] = np.nan
        z[beside] = np.nan
    return points, z


def _patches(above: Bool, tall: Bool, min_nodes: int) -> Int32:
    """Patches of the grid above the table, numbered from 1, without noise: too small, or nowhere tall.

    Diagonal neighbours are in one patch, hence no cell of the grid touches two.
    """
    from scipy.ndimage import label

    labels = label(above, np.ones((3, 3)))[0]
    keep = np.bincount(labels.ravel()) >= min_nodes
    tops = np.zeros(len(keep), np.bool_)
    tops[labels[tall]] = True
    return _renumbered(labels, keep & tops)


def _renumbered(labels: Int32, keep: Bool) -> Int32:
    """Only the labels to keep, from 1 without gaps; the others become 0."""
    keep[0] = False
    return np.where(keep, np.cumsum(keep), 0).astype(np.int32)[labels]


def _pixel_pitch(xyz: Float32) -> float:
    """Lateral distance of horizontal neighbours per depth: 1/f of a pinhole camera; 0 if there are none."""
    rows = xyz[:: max(1, len(xyz) // 4)]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ray = rows[..., 0] / rows[..., 2]
        steps = np.abs(np.diff(ray, axis=1))
    steps = steps[np.isfinite(steps)]
    if not steps.size:
        return 0.0
    middle = [(steps.size - 1) // 2, steps.size // 2]
    low, high = np.partition(steps, middle)[middle]  # a third of the time of np.median
    return float((low + high) / np.float32(2.0))


def _label_grid(window: _Window, patch: Bool, min_nodes: int) -> Int32:
    """Connected components of one patch of the coarse grid, without small ones.

    Nodes and the edges between them are drawn into an image of twice the size, whose 4-connected
    components are those of the graph.
    """
    from scipy.ndimage import label

    nodes = window.above[window.grid] & patch
    picture = np.zeros((2 * nodes.shape[0] - 1, 2 * nodes.shape[1] - 1), np.bool_)
    picture[::2, ::2] = nodes
    picture[1::2, ::2] = nodes[:-1] & nodes[1:] & _connected(window, axis=0)
    picture[::2, 1::2] = nodes[:, :-1] & nodes[:, 1:] & _connected(window, axis=1).T
    labels: Int32 = label(picture)[0][::2, ::2]
    return _renumbered(labels, np.bincount(labels.ravel()) >= min_nodes)


def _connected(window: _Window, axis: int) -> Bool:
    """Whether grid neighbours along an axis are joined by a path of pixels without depth jump or table.

    If pixels on the path have no depth, the ends may differ by a single step only.

    Returns:
        The axis first: (rows - 1, columns) of the grid, or (columns - 1, rows).
    """
    stride = window.stride
    lines = (slice(None), slice(None, None, stride))
    z, height = ((part if axis == 0 else part.T)[lines] for part in (window.z, window.height))
    span = (len(z) - 1) // stride * stride
    z = z[: span + 1]
    below = height[: span + 1] <= window.threshold.at(z)
    max_step = window.connected_step(z[:-1])
    broken = np.abs(z[1:] - z[:-1]) > max_step
    broken |= below[:-1]
    broken |= below[1:]
    allowed = np.where(_any(np.isnan(z[:-1]), stride), np.float32(1), np.float32(stride)) * max_step[::stride]
    ends = z[::stride]
    result: Bool = (np.abs(ends[1:] - ends[:-1]) <= allowed) & ~_any(broken, stride)
    return result


def _any(steps: Bool, stride: int) -> Bool:
    """Whether any of each `stride` rows is true."""
    result: Bool = steps[::stride].copy()
    for i in range(1, stride):
        result |= steps[i::stride]
    return result


def _grow(nodes: Int32, window: _Window) -> Int32:
    """The labels of the grid at full resolution.

    Pixels of a cell take the label of its corners. If two objects meet in a cell, each pixel takes that of
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


def _refine_outlines(labels: Int32, window: _Window) -> Bool:
    """Remove flying pixels from the labels and add base pixels, in place; returns which pixels are solid."""
    z = _bordered(window.z, np.nan)
    flying = _flying_pixels(labels, window, z)
    solid = labels > 0
    solid.reshape(-1)[flying] = False
    trusted = _bordered(labels * solid, 0)
    own = labels.take(flying)
    outline = np.zeros(len(flying), np.bool_)
    for neighbour in _neighbours(trusted, flying):
        outline |= neighbour == own
    labels.reshape(-1)[flying[~outline]] = 0
    base, owners = _base_pixels(solid, window, z, trusted)
    labels.reshape(-1)[base] = owners
    solid.reshape(-1)[base] = True
    return solid


def _flying_pixels(labels: Int32, window: _Window, z: Float32) -> Index:
    """Flat indices of labelled pixels in the air between two surfaces; `z` has a border of NaN."""
    # A cheap superset first: pixels beside any step that could be too large at the smallest depth.
    limit = window.support_step(np.fmin.reduce(window.z, axis=None, keepdims=True)).item()
    suspect = np.zeros(labels.shape, np.bool_)
    for image, mask in ((window.z, suspect), (window.z.T, suspect.T)):
        step = image[1:] - image[:-1]
        jump = np.abs(step, out=step) > limit
        mask[:-1] |= jump
        mask[1:] |= jump
    suspect &= labels > 0
    pixels = np.flatnonzero(suspect)
    own = window.z.take(pixels)
    near = window.support_step(own)
    steps = np.stack(list(_neighbours(z, pixels)))
    steps -= own
    support = np.count_nonzero(np.abs(steps) <= near, axis=0)
    # A steep face continues with the same slope: opposite neighbours differ by the same step.
    straight = np.count_nonzero(np.abs(steps[:4] + steps[:3:-1]) <= near, axis=0)
    flying: Index = pixels[(support < _SUPPORT) & (straight < _STRAIGHT)]
    return flying


def _base_pixels(solid: Bool, window: _Window, z: Float32, trusted: Int32) -> tuple[Index, Int32]:
    """Low pixels that touch an object and lie at its depth.

    Returns:
        Flat indices and the labels of their objects; `z` and `trusted` have a border of one pixel.
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
    threshold = window.threshold.at(own)
    low = (height > threshold * np.float32(_BASE_FRACTION)) & (height <= threshold)
    pixels, own = pixels[low], own[low]
    near = window.support_step(own)
    owners = np.zeros(len(pixels), np.int32)
    for owner, depth in zip(_neighbours(trusted, pixels), _neighbours(z, pixels), strict=True):
        owners = np.where((owner > 0) & (np.abs(depth - own) <= near), owner, owners)
    found = owners > 0
    return pixels[found], owners[found]


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
