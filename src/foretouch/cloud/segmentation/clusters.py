# SPDX-License-Identifier: Apache-2.0
"""Objects as clusters of the points above the table.

An image is labelled by its connected components (`kernels/clusters.c`). Points above the table are first labelled on a
coarse grid of pixels. Two neighbours of the grid are connected unless the pixels between them fall to the table or jump
in depth, so that an object in front of another one is not merged with it. Small clusters, as of a face that is seen
from its side, are connected across larger jumps. The labels then grow to full resolution, and
the outlines are refined:

- Flying pixels lie in the air between an object and its background, since the camera mixed both. They have few
  neighbours at their own depth. Those next to solid pixels of the object are its outline: they keep its label, but
  their depth belongs to neither surface, hence they are not solid.
- Base pixels are below the height threshold, touch an object and lie at its depth: they are the foot of the object.

Unorganised points are connected if their voxels touch. Occupied voxels are a sorted list, not a dense grid: the size of
a grid would be the scene's, and a single far point would make it huge.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from foretouch.cloud.geometry.columns import median
from foretouch.cloud.segmentation.rays import RayFilter
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.kernels import Kernel, struct
from foretouch.types import Bool, Float32, Float64, Int32, Int64, Plane

_grid_patches = Kernel("grid_patches")
_label_window = Kernel("label_window")
_residuals = Kernel("window_residuals")

NOISE_FACTOR = 2.5  # standard deviations of the depth noise, within which points belong to the table
LOCAL_FACTOR = 4.0  # times the noise of the plainest windows, where objects and the table meet
CLOSE_SLOPE = (
    5.0  # depth per lateral distance up to which neighbouring pixels are connected: a face seen at 79 degrees,
)
MAX_SLOPE = 20.0  # and where one of them belongs to a small cluster: a sliver of a face seen at 87 degrees
FLYING_SLOPE = 4.0  # beyond which a neighbour does not support a pixel; unsupported pixels are flying
_APART = 6  # cells of the coarse grid from one window of noise to the next, as in `clusters.c`
_VOXEL_M = np.float32(0.008)  # edge of the voxels that connect unorganised points


@dataclass(frozen=True, kw_only=True)
class CropConfig(Settings):
    """Depth range along the optical axis."""

    min_range_m: float = setting(0.16, "Points nearer than this are ignored", bounds=(0.0, 10.0))
    max_range_m: float = setting(2.0, "Points farther than this are ignored", bounds=(0.01, 16.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(f"min_range_m: {self.min_range_m} is not below max_range_m {self.max_range_m}")


def in_range(z: Float32, config: CropConfig) -> Bool:
    """Whether depths of any shape, float32 [m], are within the range, its ends included; false without depth."""
    return (z >= np.float32(config.min_range_m)) & (z <= np.float32(config.max_range_m))


@dataclass(frozen=True, kw_only=True)
class ClusterConfig(Settings):
    """Which points are above the table, and which of them are one object."""

    min_height_m: float = setting(0.004, "Points lower than this above the table belong to it", bounds=(0.001, 0.1))
    gap_m: float = setting(0.008, "Neighbouring pixels that differ less in depth are connected", bounds=(0.001, 0.1))
    min_points: int = setting(150, "Smaller clusters are dropped", bounds=(1, 10_000_000))
    min_top_m: float = setting(0.012, "Clusters that do not rise higher above the table are dropped", bounds=(0.0, 0.5))
    max_extent_m: float = setting(
        0.6, "Clusters larger than this along an axis are dropped: a wall, an arm", bounds=(0.01, 10.0)
    )


WritePoints = Callable[[int, int, int, int], None]
"""Writes points of an image by their first row, end of rows, first column and end of columns."""


class Clusters(NamedTuple):
    """Cluster labels of a window of the cloud."""

    labels: Int32  # (h, w) int32, an unorganised cloud in one row; 0 is none
    solid: Bool  # the same shape, bool: labelled, with a reliable depth
    n_labels: int  # the largest label
    rows: int = 0  # first row of the window, 0 if unorganised
    columns: int = 0  # first column of the window, 0 if unorganised
    # (n_labels + 1, 3) float64 of each part: the highest log odds of a join that was refused, the lowest of those that made it, both
    # infinite without any, and its cells; None where nothing called for splitting
    joins: Float64 | None = None
    pixels_per_cell: float = 0.0  # of the image that may be split; 0 where splitting is not possible

    def as_struct(self, xyz: Float32) -> Any:
        """Return the window as the kernels read and write it, in a cloud (H, W, 3) or (N, 3) float32."""
        (h, w), across = self.labels.shape, xyz.shape[-2]
        place = {"across": across, "row": self.rows, "column": self.columns, "h": h, "w": w}
        return struct("Labelled", xyz=xyz, labels=self.labels, solid=self.solid.view(np.uint8), **place)


class HeightThreshold(NamedTuple):
    """Height from which a point does not belong to the table; it grows with depth like stereo noise."""

    plane: Plane  # the table
    low_m: float  # minimum height [m]
    noise_per_m: float  # minimum height divided by z² [1/m]
    high_m: float  # maximum height [m]
    depth_m: float  # median depth of the table [m]
    local_per_m: float  # standard deviation of the depth in small windows, divided by z² [1/m]


class CoarseGrid(NamedTuple):
    """Every `stride`-th row and column of an image."""

    points: Float32  # (h, w, 3) float32 [m], contiguous
    stride: int  # [px]
    pitch: float  # lateral distance of its horizontal neighbours per depth: stride / f of a pinhole camera; 0 if there are none


def label_organised(
    xyz: Float32,
    grid: CoarseGrid,
    crop: CropConfig,
    threshold: HeightThreshold,
    config: ClusterConfig,
    rays: RayFilter | None = None,
    write: WritePoints | None = None,
) -> list[Clusters]:
    """Label an organised cloud.

    Args:
        xyz: (H, W, 3) float32 [m], contiguous, camera optical frame.
        grid: Its coarse grid.
        crop: Depth range.
        threshold: Height threshold above the table.
        config: Settings.
        rays: Drops and counts points beside the ray of their pixel, if given.
        write: Writes the points that are read into `xyz`; None if all are there.

    Returns:
        Labelled windows of the image, one around each patch above the table. The rectangles may overlap, but
        no pixel has a label in two of them. Small clusters are not yet removed.
    """
    image, shape, stride = xyz.shape[:2], grid.points.shape[:2], grid.stride
    min_nodes = max(1, config.min_points // (2 * stride * stride))  # of the grid, that may belong to an object
    settings = _settings(grid.pitch / stride, crop, threshold, config, rays)
    number, sizes = np.empty(shape, np.int32), np.empty(2, np.int64)
    boxes = np.empty((number.size // min_nodes + 1, 4), np.int64)
    sized = {"h": shape[0], "w": shape[1], "stride": stride, "min_nodes": min_nodes}
    patches = struct("Patches", number=number, settings=settings, **sized)
    _grid_patches(grid.points, patches, boxes, sizes)
    if sizes[0] < 0:
        raise MemoryError("grid_patches")
    if sizes[1] and rays is not None:
        rows, columns = np.nonzero(number < 0)
        rays.dropped.append(stride * (rows * image[1] + columns))
    spans = boxes[: sizes[0]] + np.array([-1, 1, -1, 1])  # a margin of one cell
    spans = np.minimum(np.maximum(spans, 0) * stride, (image[0], image[0], image[1], image[1]))
    low, high = spans.min(axis=0, initial=max(image)), spans.max(axis=0, initial=0)
    marks = np.zeros((max(0, high[1] - low[0]), max(0, high[3] - low[2])), np.uint8)
    marked = struct("Marks", marks=marks, row=int(low[0]), column=int(low[2]), across=marks.shape[1])
    windows: list[Clusters] = []
    beside = 0
    for patch, (top, bottom, left, right) in enumerate(spans.tolist(), 1):
        if write is not None:
            write(top, bottom, left, right)
        labels = np.empty((bottom - top, right - left), np.int32)
        window = Clusters(labels, np.empty(labels.shape, np.bool_), 0, top, left)
        _label_window(window.as_struct(xyz), patches, patch, marked, sizes)
        if sizes[0] < 0:
            raise MemoryError("label_window")
        beside += int(sizes[1])
        windows.append(window._replace(n_labels=int(sizes[0])))
    if beside and rays is not None:
        rows, columns = np.nonzero(marks & 2)
        rays.dropped.append((rows + low[0]) * image[1] + columns + low[2])
    return windows


def _settings(
    pitch: float, crop: CropConfig, threshold: HeightThreshold, config: ClusterConfig, rays: RayFilter | None
) -> Float64:
    """Return the settings of the kernels, in the order of `clusters.c`."""
    return np.array(
        [
            *threshold.plane.coefficients,
            *(threshold.low_m, threshold.noise_per_m, threshold.high_m, crop.min_range_m, crop.max_range_m),
            *(CLOSE_SLOPE * pitch, MAX_SLOPE * pitch, FLYING_SLOPE * pitch, config.gap_m, config.min_top_m),
            *([0.0] * 8 if rays is None else [1.0, *rays.numbers]),
        ]
    )


def local_noise(grid: CoarseGrid, crop: CropConfig) -> float:
    """Measure the noise of the depth where the surface is plainest.

    Unlike the residual of the whole table, it does not grow with its waves, or with a board or a second level on it.

    Args:
        grid: Coarse grid of the image.
        crop: Depth range.

    Returns:
        The s of the stereo noise sigma = s·z² [1/m], a little more than that of a quarter of the small windows of the grid;
        0 without a window in range.
    """
    h, w = grid.points.shape[:2]
    residuals, count = np.empty((h // _APART + 1) * (w // _APART + 1)), np.empty(1, np.int64)
    _residuals(grid.points, h, w, crop.min_range_m, crop.max_range_m, residuals, count)
    if not (found := int(count[0])):
        return 0.0
    return float(np.partition(residuals[:found], found // 4)[found // 4])


def pixel_pitch(xyz: Float32) -> float:
    """Measure the lateral distance of horizontal neighbours per depth: 1/f of a pinhole camera; 0 if there are none."""
    rows = xyz[:: max(1, len(xyz) // 4)]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        steps = np.abs(np.diff(rows[..., 0] / rows[..., 2], axis=1))
    steps = steps[np.isfinite(steps)]
    return median(steps) if steps.size else 0.0


def label_unorganised(xyz: Float32, crop: CropConfig, threshold: HeightThreshold) -> list[Clusters]:
    """Label an unorganised cloud (N, 3): points in touching voxels are one cluster.

    Returns:
        One window with all points, or none if nothing is above the table. Small clusters are not yet removed.
    """
    x, y, z = np.ascontiguousarray(xyz.T)
    a, b, c, d = threshold.plane.coefficients.astype(np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        height = x * a + y * b + z * c + d
        least = np.maximum(z * np.float32(threshold.noise_per_m) * z, np.float32(threshold.low_m))
        above = np.flatnonzero((height > least) & (height < np.float32(threshold.high_m)) & in_range(z, crop))
    if not len(above):
        return []
    component, count = _label_voxels(np.floor(xyz[above] / _VOXEL_M).astype(np.int64))
    labels = np.zeros((1, len(xyz)), np.int32)
    labels[0, above] = component
    return [Clusters(labels, labels > 0, count)]


def _label_voxels(cells: Int64) -> tuple[Int32, int]:
    """Connected components of occupied cells (n, 3), with 26 neighbours.

    Returns:
        (n,) int32 from 1, and the number of components.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    cells = cells - cells.min(axis=0) + 1
    size = cells.max(axis=0) + 2
    weights = np.array([size[1] * size[2], size[2], 1])
    keys, member = np.unique(cells @ weights, return_inverse=True)
    pairs = []
    # Half of the 26 directions: an undirected edge needs one entry only.
    for offset in np.ndindex(3, 3, 3):
        if offset > (1, 1, 1):
            wanted = keys + int((np.array(offset) - 1) @ weights)
            index = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = np.flatnonzero(keys[index] == wanted)
            pairs.append((hit, index[hit]))
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(len(keys), len(keys)))
    count, component = connected_components(graph, directed=False)
    return (component[member] + 1).astype(np.int32), int(count)
