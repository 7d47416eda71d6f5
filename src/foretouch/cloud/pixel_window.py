# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbours of a depth image's points from a window of pixels, with a proof that none lies outside.

A depth image keeps neighbours beside each other, so a window of pixels around a point holds its
nearest neighbours without a search tree, unless a depth edge or a slanted surface brings closer
points from farther pixels. Whether it does is decided by the rays. In the optical frame every
point Q has z > 0, and let t be the least x / z of all points right of the window. All of them then lie in
the half-space x >= t z, and a point P of the other side is at least (t z_P - x_P) / sqrt(1 + t²)
away from it. The same holds to the left, above and below. If the k-th nearest point of the window
is no farther than the nearest of the four half-spaces, no point outside can be nearer.

The half-spaces are read off the cloud itself, so neither intrinsics nor an undistorted image
are assumed: a wrong pixel index can only make the proof fail, never make it wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from foretouch.errors import CloudError
from foretouch.types import Float32, Float64

__all__ = ["PixelGrid", "window_mean_distance"]

_BLOCK_PAIRS = 30_000  # distances at a time: they fit the cache
_ROUNDING = 1.0 - 1e-5  # float32 distances are good to 1e-6 of their size
_LATTICE_TOLERANCE = 0.2  # of a pixel, between a ray and the middle of its column or row
_LATTICE_GAP = 0.25  # of the pitch; smaller gaps are rounding within a column or row
_LATTICE_CELLS = 64  # cells a point; a sparser image is no object seen by one camera


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The pixels at which points were seen, at most one point a pixel.

    Attributes:
        row: (N,) int64, 0 ... height - 1.
        column: (N,) int64, 0 ... width - 1.
        height, width: Of the part of the image that holds the points.
    """

    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]
    height: int
    width: int

    @classmethod
    def from_pixels(cls, pixels: npt.NDArray[np.integer], image_shape: tuple[int, int]) -> Self:
        """From flat, row-major indices into an image.

        Args:
            pixels: (N,) integer, all different.
            image_shape: (H, W) of the image.

        Raises:
            CloudError: If `pixels` is not such a list, or an index is outside of the image or occurs twice.
        """
        height, width = image_shape
        if pixels.ndim != 1 or not np.issubdtype(pixels.dtype, np.integer):
            raise CloudError(f"pixels: {pixels.dtype} {pixels.shape} is no list of indices")
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < height * width):
            raise CloudError(f"pixels: {pixels.min()} ... {pixels.max()} is outside of an image of {height}x{width}")
        grid = cls._cropped(*np.divmod(pixels.astype(np.int64), width))
        if grid is None:
            raise CloudError("pixels: an index occurs twice")
        return grid

    @classmethod
    def from_rays(cls, xyz: Float32) -> Self | None:
        """Recover the pixels of a shuffled depth image from its rays x / z and y / z.

        The rays of an undistorted image lie on a lattice. Where these do not, or two points share
        a ray, there is no grid.

        Args:
            xyz: (N, 3) float32 [m], finite.
        """
        if len(xyz) < 2 or xyz[:, 2].min() <= 0.0:
            return None
        z = xyz[:, 2].astype(np.float64)
        column, row = (_lattice(xyz[:, i] / z) for i in (0, 1))
        if column is None or row is None:
            return None
        if (column.max() + 1) * (row.max() + 1) > _LATTICE_CELLS * len(xyz):
            return None
        return cls._cropped(row, column)

    @classmethod
    def _cropped(cls, row: npt.NDArray[np.int64], column: npt.NDArray[np.int64]) -> Self | None:
        """Indices from the least row and column on; None where two points share a pixel."""
        if len(row) == 0:
            return cls(row, column, 0, 0)
        row, column = row - row.min(), column - column.min()
        height, width = int(row.max()) + 1, int(column.max()) + 1
        taken = np.zeros(height * width, np.bool_)
        taken[row * width + column] = True
        if np.count_nonzero(taken) != len(row):
            return None
        return cls(row, column, height, width)


def window_mean_distance(
    xyz: Float32, grid: PixelGrid, query: npt.NDArray[np.int64], k: int, half: int
) -> tuple[Float32, npt.NDArray[np.bool_]]:
    """Mean distance to the k nearest neighbours, sought among the (2 half + 1)² pixels around each point.

    Args:
        xyz: (N, 3) float32 [m], finite.
        grid: Its pixels.
        query: (Q,) int64, the points whose neighbours are sought.
        k: Neighbours, the point itself excluded; less than (2 half + 1)².
        half: Pixels from the middle of the window to its edge.

    Returns:
        (Q,) float32 [m], and (Q,) bool: whether it is proven that all k lie in the window. The
        distance of a point without proof is meaningless and may be infinite.
    """
    images = _images(xyz, grid, half)
    clearance = _squared_clearance(xyz, grid, half)
    mean = np.empty(len(query), np.float32)
    proven = np.empty(len(query), np.bool_)
    block = max(1, _BLOCK_PAIRS // (2 * half + 1) ** 2)
    for start in range(0, len(query), block):
        part = query[start : start + block]
        squared = _squared_distances(xyz[part], images, grid.row[part], grid.column[part])
        squared.partition(k, axis=1)  # the point itself, at distance 0, is among the k + 1 nearest
        proven[start : start + block] = squared[:, k] <= clearance[part]
        # Sums of a few float32 are exact in float64: their order, which the tree's differs from, has no effect.
        mean[start : start + block] = np.sqrt(squared[:, : k + 1]).sum(axis=1, dtype=np.float64) / k
    return mean, proven


def _images(xyz: Float32, grid: PixelGrid, half: int) -> list[npt.NDArray[np.float32]]:
    """Windows of x, y and z: three views (height, width, size, size), infinite at pixels without a point."""
    size = 2 * half + 1
    windows = []
    for axis in range(3):
        image = np.full((grid.height + 2 * half, grid.width + 2 * half), np.inf, np.float32)
        image[grid.row + half, grid.column + half] = xyz[:, axis]
        windows.append(sliding_window_view(image, (size, size)))
    return windows


def _squared_distances(
    points: Float32,
    images: list[npt.NDArray[np.float32]],
    row: npt.NDArray[np.int64],
    column: npt.NDArray[np.int64],
) -> Float32:
    """(Q, size²) float32 [m²]: from each point to those of its window, infinite at pixels without one."""
    squares = []
    for axis, windows in enumerate(images):
        difference = windows[row, column].reshape(len(points), -1)
        difference -= points[:, axis, None]
        difference *= difference
        squares.append(difference)
    total, *others = squares
    for square in others:
        total += square
    return total


def _squared_clearance(xyz: Float32, grid: PixelGrid, half: int) -> Float64:
    """(N,) float64 [m²]: no point outside of the window is nearer; -1 where nothing is known."""
    z = xyz[:, 2].astype(np.float64)
    if z.min() <= 0.0:
        return np.full(len(xyz), -1.0)
    clearance = np.full(len(xyz), np.inf)
    for axis, place, size in ((0, grid.column, grid.width), (1, grid.row, grid.height)):
        along = xyz[:, axis].astype(np.float64)
        ray = along / z
        for sign, index in ((1.0, place), (-1.0, size - 1 - place)):
            beyond = np.full(size + half + 1, np.inf)
            np.minimum.at(beyond, index, sign * ray)
            beyond = np.minimum.accumulate(beyond[::-1])[::-1]  # least ray of this and all farther columns
            t = beyond[index + half + 1]
            empty = np.isinf(t)
            t[empty] = 0.0
            distance = (t * z - sign * along) / np.sqrt(1.0 + t * t)
            distance[empty] = np.inf
            np.minimum(clearance, distance, out=clearance)
    return np.where(clearance > 0.0, (clearance * _ROUNDING) ** 2, -1.0)


def _lattice(ray: Float64) -> npt.NDArray[np.int64] | None:
    """Index of each ray on an evenly spaced line, or None if they do not lie on one."""
    levels = np.sort(ray)
    gaps = np.diff(levels)
    widest = gaps.max()
    if widest == 0.0:
        return None
    pitch = _pitch(gaps)
    start = levels[0]
    # One pass of least squares: a pitch off by a thousandth is a whole pixel off after a thousand columns.
    index = np.cumsum(np.concatenate([[0.0], np.rint(gaps / pitch)]))
    spread = index - index.mean()
    denominator = float(spread @ spread)
    if denominator == 0.0:
        return None
    pitch = float(spread @ levels) / denominator
    start = float(levels.mean() - pitch * index.mean())
    place = (ray - start) / pitch
    nearest = np.rint(place)
    if np.abs(place - nearest).max() > _LATTICE_TOLERANCE:
        return None
    return np.asarray(nearest, np.int64)


def _pitch(gaps: Float64) -> float:
    """The step between columns: the median of the gaps that are no rounding."""
    wide = gaps[gaps > _LATTICE_GAP * gaps.max()]
    return float(np.median(wide))
