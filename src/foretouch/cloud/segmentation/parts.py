# SPDX-License-Identifier: Apache-2.0
"""Objects that touch, split by local convexity (`kernels/split.c`).

Household objects are mostly convex, and where two of them touch, the visible surface has a concave edge or a step in depth
(Stein, Schoeler, Papon, Wörgötter: Object Partitioning using Local Convexity, CVPR 2014). A cluster is divided into fragments
along such edges and across the necks between them. Fragments are joined where boosted trees (`same_object.safetensors`, made by
`python -m benchmarks.clutter.learn`) rate them as one object, by the shape of both, of both together and of their border. It is
counted why:

- `joined_border`: rated as one object across the border that they have in common (a bottle and its neck, the walls of a bowl).
- `joined_hidden`: rated as one object on both sides of a nearer one.
- `joined_small`: smaller than a large fingertip, or of fewer than 80 cells: it belongs to the neighbour that is rated highest.

An image with neither a concave surface nor two clusters next to each other is not processed further.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from safetensors.numpy import load_file

from foretouch.cloud.geometry.columns import median
from foretouch.cloud.segmentation.clusters import LOCAL_FACTOR, Clusters, HeightThreshold, WritePoints
from foretouch.config import Settings, setting
from foretouch.kernels import Kernel, struct
from foretouch.types import Float32, Float64, Int32, Int64, UInt8

_split = Kernel("split_clusters")
_write_ids = Kernel("write_ids")
_concave = Kernel("concave_nodes")

SPLIT_COUNTS = ("clusters", "parts", "joined_small", "joined_border", "joined_hidden")
TREES = Path(__file__).with_name("same_object.safetensors")
_NO_ROWS = np.empty((0, 66))
_MAX_CELL = 8  # pixels
_ARM_M = 0.02  # over which a concave surface is looked for
_SAG_M = 0.002  # its depth below the straight line between both ends
_LEAST_PITCH, _PER_PIXEL = 0.001, 2.5  # pixels of a list: the smallest per depth, and points in each that is not empty
_STRIDE, _STRIDE_M = 4, 0.007  # between the points that are looked at: pixels, at most, and distance
_CELL_NOISE = 0.9  # side of a cell by LOCAL_FACTOR times the noise of small windows
_CELL_PER_M = 0.0035  # and at least, per depth² [1/m]: a table may be smoother than what stands on it
_UNKNOWN_CELL_PER_M = 0.0075  # the same where a table without noise says nothing about the camera
_NO_NOISE = 1e-4  # of the threshold, per depth² [1/m]
_JOINS = 3  # columns of `Clusters.joins`
_LIST_CELL_M = 0.005  # of a list of points at least: those of several views do not agree exactly
_STEP_M = 0.01  # a step in depth by more than this may separate two objects
_MIN_PART_M = 0.03  # parts smaller than a square of this side belong to the part next to them
_FEW_CELLS = 80  # of a part, whose normals are as doubtful as its outline
_FEW = 8  # concave points that noise makes; two convex parts of 3 cm meet in as many


@dataclass(frozen=True, kw_only=True)
class SplitConfig(Settings):
    """Where a cluster is split into objects that touch."""

    angle_deg: float = setting(
        22.0,
        "An edge that is concave by more than this may separate two objects, and a border that is by less on average hardly does; 180 does not split at all",
        bounds=(5.0, 180.0),
    )
    cell_m: float = setting(
        0.003,
        "Least side of the squares over which the surface is averaged; where the depth is noisier, they are larger: 3.6 times its noise in small windows",
        bounds=(0.002, 0.02),
    )
    same_object: float = setting(
        0.62,
        "Fragments are joined if the probability that they are one object is higher: less cuts fewer objects, more merges fewer",
        bounds=(0.01, 0.99),
    )


class Trees(NamedTuple):
    """Boosted trees of one depth, the nodes and leaves of each in the order of a heap."""

    features: UInt8  # (T, 2**depth - 1) that a node looks at
    thresholds: Float32  # the same: a feature above it leads to the second branch
    leaves: Float32  # (T, 2**depth) log odds

    @classmethod
    def of(cls, trees: Float32) -> Self:
        """Return trees (T, 3 * 2**depth - 2) that are stored as nodes (feature, threshold) and leaves."""
        nodes = trees[:, : 2 * (trees.shape[1] // 3)]
        leaves = trees[:, nodes.shape[1] :]
        return cls(nodes[:, ::2].astype(np.uint8), np.ascontiguousarray(nodes[:, 1::2]), np.ascontiguousarray(leaves))


@cache
def _trees() -> Trees:
    """Return the trees that rate fragments."""
    return Trees.of(load_file(TREES)["trees"])


def split_clusters(
    xyz: Float32,
    windows: Sequence[Clusters],
    threshold: HeightThreshold,
    pitch: float,
    config: SplitConfig,
    write: WritePoints | None = None,
) -> tuple[list[Clusters], dict[str, int]]:
    """Split clusters of an image into parts.

    Args:
        xyz: (H, W, 3) float32 [m], contiguous, camera optical frame.
        windows: Its labelled windows.
        threshold: Height threshold above the table, with the noise of the depth.
        pitch: Lateral distance of neighbouring pixels per depth.
        config: Settings.
        write: Writes points between the windows into `xyz`; None if all are there.

    Returns:
        The windows as they are, or one window with all parts; and the counts (`SPLIT_COUNTS`), all 0 if nothing calls for splitting.
    """
    counts = dict.fromkeys(SPLIT_COUNTS, 0)
    if config.angle_deg >= 180.0 or not windows or pitch <= 0.0:
        return list(windows), counts
    window = _in_one_window(windows) if len(windows) > 1 else windows[0]
    h, w = window.labels.shape
    coarse = np.s_[::_STRIDE, ::_STRIDE]
    seen = xyz[window.rows :, window.columns :][:h, :w, 2][coarse][window.solid[coarse]]
    depth = min(median(seen), threshold.depth_m) if len(seen) else threshold.depth_m  # a wall is far behind the table
    side = pitch * depth  # of a pixel [m]
    arm, touching = max(1, round(_ARM_M / side)), np.empty(2, np.int64)
    stride = min(_STRIDE, max(1, round(_STRIDE_M / side)))
    noise_per_m = LOCAL_FACTOR * threshold.local_per_m
    cell = _cell_of(noise_per_m, config.cell_m, depth, side)
    _concave(window.as_struct(xyz), stride, arm, _SAG_M, noise_per_m, touching)
    if touching.max() < _FEW:
        return [window._replace(pixels_per_cell=float(cell**2)) for window in windows], counts
    if write is not None and len(windows) > 1:
        write(window.rows, window.rows + h, window.columns, window.columns + w)
    settings = [
        np.radians(config.angle_deg),
        _STEP_M,
        max(_MIN_PART_M**2, _FEW_CELLS * (cell * side) ** 2),
        np.log(config.same_object / (1.0 - config.same_object)),
        *threshold.plane.coefficients,
        pitch * cell,
        threshold.local_per_m,
    ]
    labels, (*numbers, _), joins = split_window(xyz, window, cell, np.array(settings))
    counts, parts = dict(zip(counts, numbers, strict=True)), numbers[1]
    return [Clusters(labels, window.solid & (labels > 0), parts, window.rows, window.columns, joins)], counts


def split_window(
    xyz: Float32, window: Clusters, cell: int, settings: Float64, rows: Float64 = _NO_ROWS
) -> tuple[Int32, list[int], Float64]:
    """Split the clusters of a window.

    Args:
        xyz: (H, W, 3) float32 [m], contiguous, camera optical frame.
        window: Its clusters.
        cell: Side of a cell [px].
        settings: Numbers of the kernel.
        rows: (n, 66) float64, written: the pixels of both fragments in whole cells, and the input of the trees, of the first pairs that are rated.

    Returns:
        The parts (h, w) int32; the number of clusters and of parts, those that were joined for each reason, and the pairs that were rated; and
        the joins of each part (see `Clusters`).

    Raises:
        MemoryError: If there is not enough memory.
    """
    labels, known, counts = window.labels.copy(), _trees(), np.empty(len(SPLIT_COUNTS), np.int64)
    count, leaves = known.leaves.shape
    sized = {"count": count, "depth": leaves.bit_length() - 1, "rows": rows, "room": len(rows)}
    trees = struct("Trees", **known._asdict(), **sized)
    joins = np.empty((-(-labels.shape[0] // cell) * -(-labels.shape[1] // cell) + 1, _JOINS))
    clusters = np.zeros(window.n_labels + 1, np.uint8)
    _split(window._replace(labels=labels).as_struct(xyz), cell, settings, trees, counts, joins, clusters)
    if counts[0] < 0:
        raise MemoryError("split_clusters")
    return labels, [int(np.count_nonzero(clusters)), *counts.tolist()], joins[: counts[0] + 1]


def _cell_of(noise_per_m: float, least_m: float, depth: float, side: float) -> int:
    """Return the side of a cell in pixels, by the noise of the threshold, the depth and the side of a pixel [m]."""
    least = _UNKNOWN_CELL_PER_M if noise_per_m < _NO_NOISE else _CELL_PER_M
    cell_m = max(least_m, max(least, _CELL_NOISE * noise_per_m) * depth**2)
    return min(max(round(cell_m / side), 1), _MAX_CELL)


def split_list(
    xyz: Float32, windows: Sequence[Clusters], threshold: HeightThreshold, config: SplitConfig
) -> tuple[list[Clusters], dict[str, int]]:
    """Split clusters of a list of points (N, 3) that is no image: on an image of the points nearest to the camera.

    Its pixels are so large that few are empty. Points that it does not show, as those of a second view, belong to the part
    of the nearest point that it shows. Arguments and results are those of `split_clusters`, for a window of one row.
    """
    counts = dict.fromkeys(SPLIT_COUNTS, 0)
    if config.angle_deg >= 180.0 or not windows:
        return list(windows), counts
    rows = np.flatnonzero(windows[0].labels[0])
    points, clusters = xyz[rows], windows[0].labels[0, rows]
    pitch, at = _filled_pixels(points[:, :2] / points[:, 2:])
    order = np.argsort(-points[:, 2], kind="stable")
    shown = np.full(at.max(axis=0) + 1, -1, np.int64)
    shown[tuple(at[order].T)] = order  # the nearest point of each pixel is the last
    image = np.where(shown[..., None] >= 0, points[shown], np.float32(np.nan))
    labels = np.where(shown >= 0, clusters[shown], 0).astype(np.int32)
    wide = config.updated({"cell_m": max(config.cell_m, _LIST_CELL_M)})
    whole = Clusters(labels, labels > 0, windows[0].n_labels)
    split, counts = split_clusters(image, [whole], threshold, pitch, wide)
    if not counts["parts"]:
        per_cell = split[0].pixels_per_cell * len(points) / np.count_nonzero(shown >= 0)
        return [windows[0]._replace(pixels_per_cell=per_cell)], counts
    parts, front = split[0].labels[tuple(at.T)], shown[tuple(at.T)]
    hidden = (np.abs(points[:, 2] - points[front, 2]) > _STEP_M) | (clusters != clusters[front]) | (parts == 0)
    if hidden.any():
        from scipy.spatial import cKDTree

        parts[hidden] = parts[~hidden][cKDTree(points[~hidden]).query(points[hidden])[1]]
    every = np.zeros((1, len(xyz)), np.int32)
    every[0, rows] = parts
    return [Clusters(every, every > 0, split[0].n_labels, joins=split[0].joins)], counts


def _filled_pixels(place: Float32) -> tuple[float, Int64]:
    """Return a pitch of pixels that few leave empty, and the (N, 2) row and column of points, by their (N, 2) place at a depth of 1."""
    low, size, pitch = place.min(axis=0), float(np.ptp(place, axis=0).max()), _LEAST_PITCH
    while True:
        at = ((place - low) / pitch).astype(np.int64)[:, ::-1]
        width = int(at[:, 1].max()) + 1
        if size < 2.0 * pitch or len(place) >= _PER_PIXEL * len(np.unique(at[:, 0] * width + at[:, 1])):
            return pitch, at
        pitch *= 1.25


def _in_one_window(windows: Sequence[Clusters]) -> Clusters:
    """Windows of an image as one, whose labels are all different."""
    top, left = min(window.rows for window in windows), min(window.columns for window in windows)
    bottom = max(window.rows + window.labels.shape[0] for window in windows)
    right = max(window.columns + window.labels.shape[1] for window in windows)
    labels, count = np.zeros((bottom - top, right - left), np.int32), 0
    solid = np.zeros(labels.shape, np.bool_)
    for window in windows:
        (h, w), row, column = window.labels.shape, window.rows - top, window.columns - left
        ids = np.arange(count, count + window.n_labels + 1, dtype=np.int32)
        _write_ids(window.labels, h, w, row, column, ids, right - left, labels, np.empty(1, np.int64))
        solid[row : row + h, column : column + w] |= window.solid
        count += window.n_labels
    return Clusters(labels, solid, count, top, left)
