# SPDX-License-Identifier: Apache-2.0
"""The pixels of the points of a depth image, given or recovered from the rays of the points."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from foretouch.errors import CloudError
from foretouch.kernels import Kernel, struct
from foretouch.types import Float32, Float64, Int32, Int64, Integer

_ray_cells = Kernel("ray_cells")
_fill_image = Kernel("fill_image")

_LATTICE_TOLERANCE = 0.2  # of a pixel, between a ray and the middle of its column or row
_LATTICE_GAP = 0.25  # of the pitch; smaller gaps are rounding within a column or row
_LATTICE_HOLES = 5  # times that the widest gap is taken for a hole
_LATTICE_SAMPLE = 8192  # points that the lattice is fitted to
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
        """Return a grid from flat, row-major indices into an image; None if it would be large and almost empty.

        Time and memory grow with the smallest rectangle around the pixels, which a message may place anywhere.

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
        lattice = _on_lattice(xyz, 0.0, np.inf, np.inf)
        if (
            lattice is None
            or lattice.n_points != len(xyz)
            or lattice.height * lattice.width > _LATTICE_CELLS * len(xyz)
        ):
            return None
        column, row = lattice.cells.T.astype(np.int64)
        return cls._cropped(row, column)

    @classmethod
    def _cropped(cls, row: Int64, column: Int64, *, ascending: bool = False) -> Self | None:
        """Return indices relative to the first row and column; None if two points share a pixel, unless they are in ascending order."""
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


class ListedImage(NamedTuple):
    """The image that a list of points was, in whatever order."""

    xyz: Float32  # (H, W, 3) float32 [m], NaN where there is no point
    place: Int32  # (H * W,) int32, row of each pixel in the list, -1 where there is no point
    n_points: int  # in the image
    connected: int  # those with a point to their right


def listed_image(xyz: Float32, low_m: float, high_m: float, tangent: float) -> ListedImage | None:
    """Recover the image of the finite points of a list within a range of depth; None if their rays form no lattice.

    Args:
        xyz: (N, 3) float32 [m].
        low_m: Smallest depth, above 0 [m].
        high_m: Largest depth [m].
        tangent: Largest |x / z| and |y / z|, beyond which there is no image.
    """
    xyz = np.ascontiguousarray(xyz)
    lattice = _on_lattice(xyz, low_m, high_m, tangent)
    if lattice is None or lattice.height * lattice.width > _LATTICE_CELLS * lattice.n_points:
        return None
    shape = lattice.height, lattice.width
    image = np.empty((*shape, 3), np.float32)
    place = np.empty(lattice.height * lattice.width, np.int32)
    result = np.zeros(2, np.int64)
    window = struct("Window", column=lattice.column, row=lattice.row, height=lattice.height, width=lattice.width)
    _fill_image(xyz, len(xyz), lattice.rays, lattice.cells, window, image, place, result)
    return None if result[1] else ListedImage(image, place, lattice.n_points, int(result[0]))


class _Cells(NamedTuple):
    """The pixels of points, relative to any origin."""

    cells: Int32  # (N, 2) int32, column and row; -1 for points that are no part of it
    n_points: int  # that are part of it
    column: int  # smallest
    row: int  # smallest
    height: int
    width: int
    rays: Any  # the lattice, as kernels take it


def _on_lattice(xyz: Float32, low_m: float, high_m: float, tangent: float) -> _Cells | None:
    """Return the cells of the finite points (N, 3) within a range of depth; None if their rays form no lattice."""
    some = xyz
    if len(xyz) > _LATTICE_SAMPLE:
        some = xyz[np.random.default_rng(0).integers(len(xyz), size=_LATTICE_SAMPLE)]
    with np.errstate(invalid="ignore"):
        some = some[np.isfinite(some).all(axis=1) & (some[:, 2] > 0.0) & (some[:, 2] >= low_m) & (some[:, 2] <= high_m)]
    if len(some) < 2:
        return None
    z = some[:, 2].astype(np.float64)
    fits = [_lattice(some[:, i] / z) for i in (0, 1)]
    if fits[0] is None or fits[1] is None:
        return None
    cells, result = np.empty((len(xyz), 2), np.int32), np.empty(5, np.int64)
    lowest = float(np.nextafter(np.float32(low_m), np.float32(1.0))) if low_m == 0.0 else low_m
    fit = np.array([*fits[0], *fits[1]])
    rays = struct("Lattice", low=lowest, high=high_m, tangent=tangent, tolerance=_LATTICE_TOLERANCE, fit=fit)
    _ray_cells(np.ascontiguousarray(xyz), len(xyz), rays, cells, result)
    count, left, right, top, bottom = result.tolist()
    return None if count < 2 else _Cells(cells, count, left, top, bottom - top + 1, right - left + 1, rays)


def _lattice(ray: Float64) -> tuple[float, float, float] | None:
    """Fit evenly spaced lines to rays: the mean ray, one divided by the pitch, and the index of the mean; None if they are none."""
    levels = np.sort(ray)
    gaps = np.diff(levels)
    widest = gaps.max()
    for _ in range(_LATTICE_HOLES):
        if widest == 0.0:
            break
        step = np.median(gaps[gaps > _LATTICE_GAP * widest])
        index = np.cumsum(np.concatenate([[0.0], np.rint(gaps / step)]))
        # Fit a line to all rays: an error of 0.1 % in the step would be a whole pixel after a thousand columns.
        spread = index - index.mean()
        if spread.any():
            slope = (spread @ spread) / (spread @ levels)
            off = (levels - levels.mean()) * slope + index.mean()
            if np.abs(off - np.rint(off)).max() <= _LATTICE_TOLERANCE:
                return float(levels.mean()), float(slope), float(index.mean())
        widest = gaps[gaps <= widest / 2.0].max(initial=0.0)  # which was a hole of several columns
    return None
