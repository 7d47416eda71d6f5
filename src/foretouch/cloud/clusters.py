# SPDX-License-Identifier: Apache-2.0
"""What stands on the table, one label an object: in the image where the cloud is organised, else in voxels.

In the image, points above the plane are first labelled on a coarse grid of pixels. Two neighbours of the grid
belong together unless the pixels between them fall to the table or jump in depth, so that an object in front
of another one is not merged with it. The labels then grow to full resolution.

Flying pixels lie in the air between an object and what is behind it, since the camera mixed both. They are
recognised by having few neighbours at their own depth. Those next to solid pixels of the object are its
outline: they keep its label, but their depth is of neither surface, hence they are not `solid`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.types import Float32, Plane

__all__ = ["ClusterConfig", "Clusters", "HeightCut", "label_image", "label_points"]

Bool = npt.NDArray[np.bool_]
Int32 = npt.NDArray[np.int32]

_EIGHT = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
_SUPPORT = 4  # of eight neighbours at a pixel's own depth: a straight edge has 5, a flying pixel about 2


@dataclass(frozen=True, kw_only=True)
class ClusterConfig(Settings):
    """What stands out from the table, and what is one object."""

    min_height_m: float = setting(
        0.006, "Points lower than this above the table belong to it", minimum=0.001, maximum=0.1, unit="m"
    )
    noise_factor: float = setting(
        3.0,
        "Points also belong to the table within so many standard deviations of the depth noise measured on it",
        minimum=0.0,
        maximum=10.0,
    )
    max_height_m: float = setting(
        0.6, "Points higher than this above the table are ignored", minimum=0.01, maximum=5.0, unit="m"
    )
    gap_m: float = setting(
        0.008, "Neighbouring pixels that differ less in depth are connected", minimum=0.001, maximum=0.1, unit="m"
    )
    max_slope: float = setting(
        6.0,
        "Depth per lateral distance of a steep surface that is still connected, tan(80 degrees)",
        minimum=1.0,
        maximum=50.0,
    )
    voxel_m: float = setting(
        0.008, "Cells by which unorganised points are connected", minimum=0.001, maximum=0.1, unit="m"
    )
    min_points: int = setting(150, "Smaller clusters are dropped", minimum=1, maximum=10_000_000)
    min_top_m: float = setting(
        0.012,
        "Clusters that nowhere rise higher above the table are dropped as noise",
        minimum=0.0,
        maximum=0.5,
        unit="m",
    )
    max_extent_m: float = setting(
        0.6, "Clusters larger than this along an axis are dropped: a wall, an arm", minimum=0.01, maximum=10.0, unit="m"
    )


class Clusters(NamedTuple):
    """Labels of a part of the cloud.

    Attributes:
        labels: (h, w) or (n,) int32; 0 is none.
        solid: The same shape, bool: labelled, and its depth can be trusted.
        count: The largest label.
        rows: First row of the part, 0 where not organised.
        columns: First column of the part.
    """

    labels: Int32
    solid: Bool
    count: int
    rows: int = 0
    columns: int = 0


class HeightCut(NamedTuple):
    """From which height a point no longer belongs to the table, growing with its depth as stereo noise does.

    Attributes:
        plane: The table.
        low_m: Least height [m].
        noise_per_m: Least height divided by z² [1/m].
        high_m: Greatest height [m].
    """

    plane: Plane
    low_m: float
    noise_per_m: float
    high_m: float

    def split(self, xyz: Float32) -> tuple[Bool, Bool]:
        """Points (..., 3) that stand out, and those that belong to the table or lie below it.

        Points without depth are in neither.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            height = self.plane.height(xyz)
            z = xyz[..., 2]
            cut = np.maximum(np.float32(self.noise_per_m) * z * z, np.float32(self.low_m))
            return (height > cut) & (height < np.float32(self.high_m)), height <= cut


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


def label_image(xyz: Float32, in_range: Bool, cut: HeightCut, config: ClusterConfig, stride: int) -> Clusters | None:
    """Label an organised cloud.

    Args:
        xyz: (H, W, 3) float32 [m], camera optical frame.
        in_range: (H, W), pixels that count.
        cut: What is table.
        config: What is one object.
        stride: Of the coarse grid [px].

    Returns:
        The labelled part of the image, None where nothing stands out. The labels still hold small clusters.
    """
    coarse = xyz[::stride, ::stride]
    above = cut.split(coarse)[0] & in_range[::stride, ::stride]
    if not above.any():
        return None
    window, (row, column) = _window(xyz, in_range, cut, config, above, stride)
    jumps = _jump(window, 0), _jump(window, 1)
    nodes = _label_grid(window, jumps, max(1, config.min_points // (4 * stride * stride)))
    labels = _grow(nodes, window)
    solid = _reject_flying(labels, window, jumps)
    return Clusters(labels, solid, int(nodes.max(initial=0)), row, column)


def _window(
    xyz: Float32, in_range: Bool, cut: HeightCut, config: ClusterConfig, above: Bool, stride: int
) -> tuple[_Window, tuple[int, int]]:
    """The part around all that stands out, with a margin of one cell."""
    spans = []
    for axis in (0, 1):
        hit = np.flatnonzero(above.any(axis=1 - axis))
        spans.append(slice(max(int(hit[0]) - 1, 0) * stride, (int(hit[-1]) + 2) * stride))
    part = xyz[spans[0], spans[1]]
    high, low = cut.split(part)
    z = np.ascontiguousarray(part[..., 2])
    slope = np.float32(config.max_slope * _pixel_pitch(xyz[::stride, ::stride]) / stride)
    with np.errstate(invalid="ignore"):
        reach = np.maximum(z * slope, np.float32(config.gap_m))
    window = _Window(z, high & in_range[spans[0], spans[1]], low, reach, stride)
    return window, (spans[0].start, spans[1].start)


def _pixel_pitch(xyz: Float32) -> float:
    """Lateral distance of horizontal neighbours per depth: 1/f of a pinhole camera; 0 if there are none."""
    rows = xyz[:: max(1, len(xyz) // 16)]
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
    """Whether grid neighbours along the first axis are joined by a path of pixels that neither jumps nor meets the table.

    Pixels without depth on the path say nothing; the ends may then differ by what the measured steps allow.
    """
    ends = z[::stride, ::stride]
    count = len(ends) - 1
    span = count * stride
    below = below[:, ::stride]
    broken = jump[:span, ::stride] | below[:span] | below[1 : span + 1]
    known = np.isfinite(z[: span + 1, ::stride])
    steps = (
        np.add.reduceat(known[:span] & known[1:], np.arange(0, span, stride), axis=0, dtype=np.float32) if count else 0
    )
    with np.errstate(invalid="ignore"):
        near = np.abs(np.diff(ends, axis=0)) <= np.maximum(steps, 1) * reach[::stride, ::stride][:-1]
    result: Bool = near & ~broken.reshape(count, stride, -1).any(axis=1)
    return result


def _grow(nodes: Int32, window: _Window) -> Int32:
    """The labels of the grid at full resolution.

    A cell whose four corners agree takes their label; in other cells each pixel takes that of the labelled
    corner which is nearest in depth, if one is near enough.
    """
    height, width = window.z.shape
    stride = window.stride
    padded = np.pad(nodes, ((0, 1), (0, 1)), mode="edge")
    corners = np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
    cells = np.where((corners == corners[0]).all(axis=0), nodes, np.int32(-1))
    labels = np.repeat(np.repeat(cells, stride, axis=1), stride, axis=0)[:height, :width] * window.above
    open_ = np.flatnonzero(labels < 0)
    rows, columns = np.divmod(open_, width)
    cell_rows, cell_columns = rows // stride, columns // stride
    choices = corners[:, cell_rows, cell_columns]
    grid_z = np.pad(window.z[window.coarse], ((0, 1), (0, 1)), mode="edge")
    depths = np.stack([grid_z[cell_rows + i, cell_columns + j] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))])
    apart = np.abs(depths - window.z.reshape(-1)[open_])
    apart[(choices == 0) | ~np.isfinite(apart)] = np.inf
    nearest = apart.argmin(axis=0)
    index = np.arange(len(open_))
    near = apart[nearest, index] <= stride * window.reach.reshape(-1)[open_]
    labels.reshape(-1)[open_] = np.where(near, choices[nearest, index], 0)
    return labels


def _reject_flying(labels: Int32, window: _Window, jumps: tuple[Bool, Bool]) -> Bool:
    """Take labels from pixels in the air, in place, and tell which labelled pixels are solid."""
    suspect = np.zeros(labels.shape, np.bool_)
    suspect[:-1] |= jumps[0]
    suspect[1:] |= jumps[0]
    suspect[:, :-1] |= jumps[1]
    suspect[:, 1:] |= jumps[1]
    solid = labels > 0
    rows, columns = np.divmod(np.flatnonzero(suspect & solid), labels.shape[1])
    z, reach = window.z[rows, columns], window.reach[rows, columns]
    padded_z = np.pad(window.z, 1, constant_values=np.nan)
    support = np.zeros(len(rows), np.int8)
    with np.errstate(invalid="ignore"):
        for i, j in _EIGHT:
            support += np.abs(padded_z[rows + 1 + i, columns + 1 + j] - z) <= reach
    flying = support < _SUPPORT
    rows, columns = rows[flying], columns[flying]
    solid[rows, columns] = False
    padded = np.pad(labels * solid, 1)
    own = labels[rows, columns]
    outline = np.zeros(len(rows), np.bool_)
    for i, j in _EIGHT:
        outline |= padded[rows + 1 + i, columns + 1 + j] == own
    labels[rows[~outline], columns[~outline]] = 0
    return solid


def label_points(xyz: Float32, in_range: Bool, cut: HeightCut, config: ClusterConfig) -> Clusters | None:
    """Label a cloud without order: points in touching voxels belong together.

    Args:
        xyz: (N, 3) float32 [m].
        in_range: (N,), points that count.
        cut: What is table.
        config: What is one object.

    Returns:
        One label a point, None where nothing stands out. The labels still hold small clusters.
    """
    above = np.flatnonzero(cut.split(xyz)[0] & in_range)
    if not len(above):
        return None
    cells = np.floor(xyz[above] / np.float32(config.voxel_m)).astype(np.int64)
    component, count = _label_voxels(cells)
    labels = np.zeros(len(xyz), np.int32)
    labels[above] = component
    return Clusters(labels, labels > 0, count)


def _label_voxels(cells: npt.NDArray[np.int64]) -> tuple[Int32, int]:
    """Components of occupied cells (n, 3), all 26 neighbours connected.

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
    # Half of the 26 directions: a link needs one entry only.
    for offset in np.ndindex(3, 3, 3):
        if offset > (1, 1, 1):
            wanted = keys + int((np.array(offset) - 1) @ weights)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = np.flatnonzero(keys[place] == wanted)
            pairs.append((hit, place[hit]))
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(len(keys), len(keys)))
    count, component = connected_components(graph, directed=False)
    return (component[member] + 1).astype(np.int32), int(count)
