# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbours of a depth image's points from a window of pixels, with a proof that none lies outside.

In a depth image neighbours are adjacent, so a window of pixels around a point contains its nearest neighbours without a
search tree, unless a depth edge or a slanted surface brings closer points from farther pixels. The rays decide which:
in the optical frame every point Q has z > 0; let t be the smallest x / z of all points right of the window. All
of them are in the half-space x >= t z, and a point P on the other side is at least (t z_P - x_P) / sqrt(1 + t²)
away from it. The same holds to the left, above and below. If the k-th nearest point of the window is no farther
than the nearest of the four half-spaces, no point outside can be nearer.

The half-spaces are computed from the cloud itself and require neither intrinsics nor an undistorted image: a wrong
pixel index can make the proof fail, but never make it wrong.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError
from foretouch.types import Float32, Float64

_BAND_SLOTS = 8192  # pixels at a time: their windows take 4 MB
_BLOCK_POINTS = 250
_FAR_M = 1e18  # whose square float32 still holds
_ROUNDING = 1.0 - 1e-5  # float32 distances are accurate to 1e-6 of their size
_LATTICE_TOLERANCE = 0.2  # of a pixel, between a ray and the middle of its column or row
_LATTICE_GAP = 0.25  # of the pitch; smaller gaps are rounding within a column or row
_LATTICE_SIZE = 1e5  # columns or rows of any camera
_LATTICE_CELLS = 64  # cells per point; a sparser image is not an object seen by one camera
_IMAGE_CELLS = 1280 * 720  # cells in any case: a depth image of a RealSense
_IMAGE_SIDE = 4096  # columns or rows in any case
# Pixels from the centre of the window to its edge. On a frontal surface 50 neighbours are within 4 pixels, at
# its rim within 6; a wider window costs more than the tree needs for the points this one leaves unproven.
_REACH = 5


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The pixels of the points of a depth image, at most one point per pixel."""

    row: npt.NDArray[np.int64]  # (N,) int64, 0 ... height - 1
    column: npt.NDArray[np.int64]  # (N,) int64, 0 ... width - 1
    height: int  # size of the part of the image that contains the points
    width: int

    @classmethod
    def from_pixels(cls, pixels: npt.NDArray[np.integer], image_shape: tuple[int, int]) -> Self | None:
        """A grid from flat, row-major indices into an image; None if it would be large and almost empty.

        Time and memory are those of the smallest rectangle around the pixels, which a message may place anywhere.

        Args:
            pixels: (N,) integer, all different.
            image_shape: (H, W) of the image.

        Raises:
            CloudError: If `pixels` are not such indices, or one is outside of the image or occurs twice.
        """
        height, width = image_shape
        if pixels.ndim != 1 or not np.issubdtype(pixels.dtype, np.integer):
            raise CloudError(f"pixels: {pixels.dtype} {pixels.shape} is no list of indices")
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < height * width):
            raise CloudError(f"pixels: {pixels.min()} ... {pixels.max()} is outside of an image of {height}x{width}")
        row, column = np.divmod(pixels.astype(np.int64), width)
        if len(pixels):
            tall, wide = int(np.ptp(row)), int(np.ptp(column))
            if max(tall, wide) > _IMAGE_SIDE or tall * wide > max(_IMAGE_CELLS, _LATTICE_CELLS * len(pixels)):
                return None
        grid = cls._cropped(row, column)
        if grid is None:
            raise CloudError("pixels: an index occurs twice")
        return grid

    @classmethod
    def from_rays(cls, xyz: Float32) -> Self | None:
        """Recover the pixels of an unordered depth image from its rays x / z and y / z.

        The rays of an undistorted image form a lattice. If these do not, or two points share a ray, there is no grid.

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
        """Indices relative to the first row and column; None if two points share a pixel."""
        if len(row) == 0:
            return cls(row, column, 0, 0)
        row, column = row - row.min(), column - column.min()
        height, width = int(row.max()) + 1, int(column.max()) + 1
        taken = np.zeros(height * width, np.bool_)
        taken[row * width + column] = True
        if np.count_nonzero(taken) != len(row):
            return None
        return cls(row, column, height, width)


def window_mean_distance(xyz: Float32, grid: PixelGrid, k: int) -> tuple[Float32, npt.NDArray[np.bool_]]:
    """Mean distance to the k nearest neighbours, searched among the pixels around each point.

    Args:
        xyz: (N, 3) float32 [m], finite, N > k.
        grid: Its pixels.
        k: Number of neighbours, excluding the point itself.

    Returns:
        (N,) float32 [m], and (N,) bool: whether it is proven that no nearer points exist elsewhere.
        Without this proof the distance is meaningless.
    """
    mean = np.zeros(len(xyz), np.float32)
    proven = np.zeros(len(xyz), np.bool_)
    if k >= (2 * _REACH + 1) ** 2 or not xyz[:, 2].min() > 0.0:
        return mean, proven
    clearance = _squared_clearance(xyz, grid)
    image = _PaddedImage(xyz, grid)
    for start, stop, points in image.bands():
        window = image.squared_distances(start, stop)
        for part in np.array_split(points, len(points) // _BLOCK_POINTS + 1):
            squared = np.ascontiguousarray(window.take(image.slot[part] - start, axis=1).T)
            squared.partition(k, axis=1)  # the point itself, at distance 0, is among the k + 1 nearest
            proven[part] = squared[:, k] <= clearance[part]
            # Sums of a few float32 are exact in float64: their order, which differs from the tree's, has no effect.
            mean[part] = np.sqrt(squared[:, : k + 1]).sum(axis=1, dtype=np.float64) / k
    return mean, proven


class _PaddedImage:
    """x, y and z at each pixel, row by row, far away where there is no point.

    The padding to the right of a row is also that to the left of the next, so a window is the same list of offsets
    from any slot, and the points at one offset are the image itself, shifted.

    Attributes:
        slot: (N,) int64, index of each point in the padded image.
    """

    def __init__(self, xyz: Float32, grid: PixelGrid) -> None:
        width = grid.width + _REACH
        self._margin = _REACH * width + _REACH
        self.slot = self._margin + grid.row * width + grid.column
        self._channels = np.full((3, grid.height * width + 2 * self._margin), _FAR_M, np.float32)
        self._channels[:, self.slot] = xyz.T
        offsets = np.arange(-_REACH, _REACH + 1)
        self._offsets = (offsets[:, None] * width + offsets).reshape(-1)

    def bands(self) -> Iterator[tuple[int, int, npt.NDArray[np.int64]]]:
        """First slot, end and points of each piece of the image whose windows fit the cache; empty ones are skipped."""
        order = np.argsort(self.slot)
        starts = np.arange(self._margin, self._channels.shape[1] - self._margin, _BAND_SLOTS)
        for start, points in zip(starts, np.split(order, np.searchsorted(self.slot[order], starts[1:])), strict=True):
            if len(points):
                yield int(start), min(int(start) + _BAND_SLOTS, self._channels.shape[1] - self._margin), points

    def squared_distances(self, start: int, stop: int) -> Float32:
        """((2 reach + 1)², stop - start) float32 [m²]: from each slot to those of its window.

        Distances are symmetric, so only half of the offsets are computed.
        """
        size = stop - start
        result = np.zeros((len(self._offsets), size), np.float32)
        squares = np.empty((3, size + self._margin), np.float32)
        middle = len(self._offsets) // 2
        for i in range(1, middle + 1):
            offset = int(self._offsets[middle + i])
            here, there = slice(start - offset, stop), slice(start, stop + offset)
            square = squares[:, : size + offset]
            np.subtract(self._channels[:, there], self._channels[:, here], out=square)
            np.multiply(square, square, out=square)
            x, y, z = square
            x += y
            x += z
            result[middle + i] = x[offset:]
            result[middle - i] = x[:size]
        return result


def _squared_clearance(xyz: Float32, grid: PixelGrid) -> Float64:
    """(N,) float64 [m²]: no point outside of the window is nearer; -1 where nothing can be proven."""
    x, y, z = xyz.T.astype(np.float64)
    clearance = np.full(len(xyz), np.inf)
    for pixel, along, size in ((grid.column, x, grid.width), (grid.row, y, grid.height)):
        for sign, index in ((1.0, pixel), (-1.0, size - 1 - pixel)):
            smallest = np.full(size + _REACH + 1, np.inf)
            np.minimum.at(smallest, index, sign * along / z)
            smallest = np.minimum.accumulate(smallest[::-1])[::-1]  # rays of this and all farther columns or rows
            t = smallest[index + _REACH + 1]
            beyond = np.flatnonzero(np.isfinite(t))  # no point lies farther in this direction elsewhere
            t = t[beyond]
            distance = (t * z[beyond] - sign * along[beyond]) / np.sqrt(1.0 + t * t)
            clearance[beyond] = np.minimum(clearance[beyond], distance)
    return np.where(clearance > 0.0, (clearance * _ROUNDING) ** 2, -1.0)


def _lattice(ray: Float64) -> npt.NDArray[np.int64] | None:
    """Index of each ray on an evenly spaced line, or None if they are not evenly spaced."""
    levels = np.sort(ray)
    gaps = np.diff(levels)
    if gaps.max() == 0.0:
        return None
    step = np.median(gaps[gaps > _LATTICE_GAP * gaps.max()])
    index = np.cumsum(np.concatenate([[0.0], np.rint(gaps / step)]))
    # Fit a line to all rays: an error of 0.1 % in the step would be a whole pixel after a thousand columns.
    spread = index - index.mean()
    if not spread.any():
        return None
    pitch = (spread @ levels) / (spread @ spread)
    position = (ray - levels.mean()) / pitch + index.mean()
    nearest = np.rint(position)
    if np.abs(position - nearest).max() > _LATTICE_TOLERANCE or np.abs(nearest).max() > _LATTICE_SIZE:
        return None
    return np.asarray(nearest, np.int64)
