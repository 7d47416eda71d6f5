# SPDX-License-Identifier: Apache-2.0
"""The pixels of the points of a depth image, given or recovered from the rays of the points."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from foretouch.errors import CloudError
from foretouch.types import Float32, Float64, Int64, Integer

_LATTICE_TOLERANCE = 0.2  # of a pixel, between a ray and the middle of its column or row
_LATTICE_GAP = 0.25  # of the pitch; smaller gaps are rounding within a column or row
_LATTICE_SIZE = 1e5  # columns or rows of any camera
_LATTICE_CELLS = 64  # cells per point; a sparser image is not an object seen by one camera
_IMAGE_CELLS = 1280 * 720  # cells in any case: a depth image of a RealSense
_IMAGE_SIDE = 4096  # columns or rows in any case


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The pixels of the points of a depth image, at most one point per pixel."""

    row: Int64  # (N,) int64, 0 ... height - 1
    column: Int64  # (N,) int64, 0 ... width - 1
    height: int  # size of the part of the image that contains the points
    width: int

    @classmethod
    def from_pixels(cls, pixels: Integer, image_shape: tuple[int, int]) -> Self | None:
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
            raise CloudError(f"pixels: {pixels.dtype} {pixels.shape} is not a list of indices")
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < height * width):
            raise CloudError(f"pixels: {pixels.min()} ... {pixels.max()} is outside of an image of {height}x{width}")
        flat: Int64 = pixels.astype(np.int64)
        row = flat // width  # in a third of the time of divmod()
        column = flat - row * width
        if len(pixels):
            tall, wide = int(np.ptp(row)), int(np.ptp(column))
            if max(tall, wide) > _IMAGE_SIDE or tall * wide > max(_IMAGE_CELLS, _LATTICE_CELLS * len(pixels)):
                return None
        grid = cls._cropped(row, column, ascending=bool((pixels[1:] > pixels[:-1]).all()))
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
    def _cropped(cls, row: Int64, column: Int64, *, ascending: bool = False) -> Self | None:
        """Indices relative to the first row and column; None if two points share a pixel, unless they are in ascending order."""
        if len(row) == 0:
            return cls(row, column, 0, 0)
        row, column = row - row.min(), column - column.min()
        height, width = int(row.max()) + 1, int(column.max()) + 1
        if not ascending:
            taken = np.zeros(height * width, np.bool_)
            taken[row * width + column] = True
            if np.count_nonzero(taken) != len(row):
                return None
        return cls(row, column, height, width)


def _lattice(ray: Float64) -> Int64 | None:
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
