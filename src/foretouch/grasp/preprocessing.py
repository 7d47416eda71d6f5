# SPDX-License-Identifier: Apache-2.0
"""Preprocess an object's cloud for GeoGrasp: drop points that are not finite or in the air, downsample, remove outliers."""

import math
from dataclasses import dataclass

import numpy as np

from foretouch.cloud.geometry.flying import flying_mask
from foretouch.cloud.geometry.frames import has_depth
from foretouch.cloud.geometry.pcl_filters import inlier_mask
from foretouch.cloud.geometry.pixel_grid import PixelGrid
from foretouch.errors import CloudError
from foretouch.grasp.config import GeoGraspConfig
from foretouch.kernels import Kernel
from foretouch.types import Cloud, Float32, Int64, Integer

_sort = Kernel("canonical_order")

_UNKNOWN = 4  # times as many points are kept of clouds that are no image
_MIN_POINTS = 3  # fewer define neither an axis nor a grasp plane
_MAX_COORDINATE_M = 1000.0  # depth cameras reach 20 m; larger numbers are in another unit or damaged


@dataclass(frozen=True, eq=False)
class FinitePoints:
    """The finite points of a cloud."""

    xyz: Float32  # (N, 3) float32 [m]
    n_dropped: int  # number of points that were not finite
    pixels: Int64 | None = None  # (N,) int64, flat indices into the image, or None
    image_shape: tuple[int, int] | None = None  # (H, W) of that image, or None

    def in_canonical_order(self) -> "FinitePoints":
        """Return the same points by x, then y, then z, so that sums and ties do not depend on the order of the input."""
        order = _canonical_order(self.xyz)
        pixels = None if self.pixels is None else self.pixels[order]
        return FinitePoints(np.ascontiguousarray(self.xyz[order]), self.n_dropped, pixels, self.image_shape)

    def downsampled(self, config: GeoGraspConfig) -> "FinitePoints":
        """Return at most about `config.max_points`: every k-th row and column, or every k-th point without an image.

        The computing time grows with the square of the density, and a near object is sampled far more densely than
        the fingertip needs. The pattern starts at the object's own corner, so it does not depend on
        whether the pixels were given or recovered from the rays.

        Raises:
            CloudError: If there are fewer than three points, one is a kilometre away, or the given pixels are wrong.
        """
        self._check()
        if self.pixels is not None and self.image_shape is not None:
            grid = PixelGrid.from_pixels(self.pixels, self.image_shape)
        if config.max_points == 0 or len(self.xyz) <= config.max_points:
            return self
        ratio = len(self.xyz) / config.max_points
        if self.pixels is None:
            grid = PixelGrid.from_rays(self.xyz)
        if grid is None:
            return FinitePoints(self.xyz[:: math.ceil(ratio)], self.n_dropped)
        step = math.ceil(math.sqrt(ratio))
        kept = np.flatnonzero((grid.row % step == 0) & (grid.column % step == 0))
        return FinitePoints(self.xyz[kept], self.n_dropped)

    def _check(self) -> None:
        """Refuse clouds of too few points or in another unit, with a `CloudError`."""
        if len(self.xyz) < _MIN_POINTS:
            raise CloudError(f"xyz: {len(self.xyz)} finite points, GeoGrasp needs {_MIN_POINTS}")
        farthest = float(np.abs(self.xyz).max())
        if farthest > _MAX_COORDINATE_M:
            raise CloudError(f"xyz: reaches {farthest:g} m, beyond {_MAX_COORDINATE_M:g} m; is it in metres?")

    def every_kth_pixel(self, most: int) -> "FinitePoints":
        """Return at most about `most` points on a lattice of pixels, so that small changes of the cloud keep the choice.

        Up to four times as many, evenly distributed over their order, if that image cannot be recovered. In canonical order; raises as
        `downsampled`.
        """
        self._check()
        step = -(-len(self.xyz) // most)
        if step > 1:
            if self.pixels is not None and self.image_shape is not None:
                grid = PixelGrid.from_pixels(self.pixels, self.image_shape)
            else:
                grid = PixelGrid.from_rays(self.xyz)
            if grid is not None:
                place = round(0.38 * step) * grid.row + grid.column
                kept = np.flatnonzero(place == place // step * step)  # in half the time of a remainder
                return FinitePoints(self.xyz[kept], self.n_dropped).in_canonical_order()
        ordered = self.in_canonical_order()
        return FinitePoints(ordered.xyz[:: -(-len(self.xyz) // (_UNKNOWN * most))], self.n_dropped)

    def without_flying(self, config: GeoGraspConfig, counts: dict[str, int]) -> "FinitePoints":
        """Drop flying points (see `flying_mask`).

        Args:
            config: Settings.
            counts: Gets their number as `n_flying`, if there are any.
        """
        flying = flying_mask(self.xyz, config.flying_share)
        if not flying.any():
            return self
        counts["n_flying"] = int(np.count_nonzero(flying))
        return FinitePoints(self.xyz[~flying], self.n_dropped)

    def without_outliers(self, config: GeoGraspConfig) -> Float32:
        """Return (M, 3) float32 [m], the points that the statistical outlier filter keeps."""
        return self.xyz[inlier_mask(self.xyz, config.neighbours, config.outlier_deviations)]


def _canonical_order(xyz: Float32) -> Int64:
    order = np.empty(len(xyz), np.int64)
    _sort(np.ascontiguousarray(xyz), len(xyz), order)
    if len(order) and order[0] < 0:
        raise MemoryError("canonical_order")
    return order


def finite_points(
    cloud: Cloud, pixels: Integer | None = None, image_shape: tuple[int, int] | None = None
) -> FinitePoints:
    """Drop and count the points that are not finite, or at (0, 0, 0), which cameras send for a pixel without depth.

    Args:
        cloud: An object's points, organised or not.
        pixels: (N,) integer, for an unorganised cloud cut from an image: flat indices into it.
        image_shape: (H, W) of that image; required with `pixels`.

    Raises:
        CloudError: If the pixels do not belong to the cloud.
    """
    xyz = cloud.xyz.reshape(-1, 3)
    if cloud.organised:
        if pixels is not None:
            raise CloudError("pixels: not allowed for an organised cloud, which defines its own")
        pixels, image_shape = np.arange(len(xyz)), (cloud.xyz.shape[0], cloud.xyz.shape[1])
    if (pixels is None) != (image_shape is None):
        raise CloudError("pixels, image_shape: one is given without the other")
    if pixels is not None and pixels.shape != (len(xyz),):
        raise CloudError(f"pixels: shape {pixels.shape} does not match {len(xyz)} points")
    finite = has_depth(xyz)
    n_dropped = len(xyz) - int(np.count_nonzero(finite))
    if n_dropped:
        xyz = xyz[finite]
        pixels = None if pixels is None else pixels[finite]
    return FinitePoints(xyz, n_dropped, None if pixels is None else pixels.astype(np.int64), image_shape)
