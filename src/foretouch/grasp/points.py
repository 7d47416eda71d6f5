# SPDX-License-Identifier: Apache-2.0
"""What of a cloud GeoGrasp can use: the finite points and, where it is known, their pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.pixel_window import PixelGrid
from foretouch.errors import CloudError
from foretouch.types import Cloud, Float32

__all__ = ["UsablePoints", "usable_points"]

_FEWEST = 3  # points, below which there is no axis and no slab
_FARTHEST_M = 1000.0  # a depth camera ends at 20 m; larger numbers are another unit or damage


@dataclass(frozen=True, eq=False)
class UsablePoints:
    """The finite points of a cloud.

    Attributes:
        xyz: (N, 3) float32 [m].
        n_dropped: Points that were not finite.
        pixels: (N,) int64, flat indices into the image, or None.
        image_shape: (H, W) of that image, or None.
    """

    xyz: Float32
    n_dropped: int
    pixels: npt.NDArray[np.int64] | None = None
    image_shape: tuple[int, int] | None = None

    def require_usable(self) -> None:
        """Raise a CloudError if there are fewer than three points, or one is a kilometre away."""
        if len(self.xyz) < _FEWEST:
            raise CloudError(f"xyz: {len(self.xyz)} finite points, GeoGrasp needs {_FEWEST}")
        farthest = float(np.abs(self.xyz).max())
        if farthest > _FARTHEST_M:
            raise CloudError(f"xyz: reaches {farthest:g} m, beyond {_FARTHEST_M:g} m")

    def pixel_grid(self) -> PixelGrid | None:
        """The pixels as given, else as the rays tell them, else None."""
        if self.pixels is None or self.image_shape is None:
            return PixelGrid.from_rays(self.xyz)
        return PixelGrid.from_pixels(self.pixels, self.image_shape)

    def thinned(self, most: int) -> UsablePoints:
        """Every k-th row and column of the image, or every k-th point where there is no image.

        The work grows with the square of the density, and a near object is seen far more densely than
        the fingertip needs. The pattern starts at the object's own corner, so it does not depend on
        whether the pixels were given or read off the rays.

        Args:
            most: Clouds of no more points are left as they are; 0 leaves all.
        """
        if most == 0 or len(self.xyz) <= most:
            return self
        ratio = len(self.xyz) / most
        grid = self.pixel_grid()
        if grid is None:
            return UsablePoints(self.xyz[:: math.ceil(ratio)], self.n_dropped)
        step = math.ceil(math.sqrt(ratio))
        kept = np.flatnonzero((grid.row % step == 0) & (grid.column % step == 0))
        pixels = grid.row[kept] // step * grid.width + grid.column[kept] // step
        return UsablePoints(self.xyz[kept], self.n_dropped, pixels, (grid.height, grid.width))


def usable_points(
    cloud: Cloud, pixels: npt.NDArray[np.integer] | None = None, image_shape: tuple[int, int] | None = None
) -> UsablePoints:
    """Leave out the points that are not finite and keep count of them.

    Args:
        cloud: An object's points, organised or not.
        pixels: (N,) integer, where an unorganised cloud was cut from an image: flat indices into it.
        image_shape: (H, W) of that image; goes with `pixels`.

    Raises:
        CloudError: If the pixels do not belong to the cloud.
    """
    xyz = cloud.xyz.reshape(-1, 3)
    if cloud.organised:
        if pixels is not None:
            raise CloudError("pixels: the cloud is organised and knows its own")
        pixels, image_shape = np.arange(len(xyz)), (cloud.xyz.shape[0], cloud.xyz.shape[1])
    if (pixels is None) != (image_shape is None):
        raise CloudError("pixels, image_shape: one is given without the other")
    if pixels is not None and pixels.shape != (len(xyz),):
        raise CloudError(f"pixels: shape {pixels.shape} does not go with {len(xyz)} points")
    finite = np.isfinite(xyz[:, 0]) & np.isfinite(xyz[:, 1]) & np.isfinite(xyz[:, 2])
    n_dropped = len(xyz) - int(np.count_nonzero(finite))
    if n_dropped:
        xyz = xyz[finite]
        pixels = None if pixels is None else pixels[finite]
    return UsablePoints(xyz, n_dropped, None if pixels is None else pixels.astype(np.int64), image_shape)
