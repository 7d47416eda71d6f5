# SPDX-License-Identifier: Apache-2.0
"""Depth images to organised clouds, for all cameras of this package: real, recorded or simulated.

The direction of each pixel depends on the lens only, so it is computed once (in double precision,
rounded once to float32) and each frame takes two multiplications per pixel. `librealsense` computes
the same in float32 throughout; the two differ by float32 rounding only. Depth images of the D400 cameras are rectified: they have
no distortion.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CameraError
from foretouch.types import Float32, Float64


def pinhole_matrix(width: int, height: int, hfov_deg: float = 65.0) -> Float64:
    """(3, 3) float64 intrinsics [px] of square pixels, a centred axis and a horizontal field of view; the D415 has 65 deg."""
    # Rounded to float32 as a device stores it, so that frames sent through one stay bit-equal.
    focal = float(np.float32(width / (2.0 * np.tan(np.radians(hfov_deg) / 2.0))))
    return np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Deprojector:
    """Pixel directions of one lens."""

    x: Float32  # (H, W) float32, x / z of each pixel in the optical frame
    y: Float32  # (H, W) float32, y / z of each pixel

    @classmethod
    def of_lens(cls, matrix: Float64, width: int, height: int) -> Self:
        """Make the deprojector of a lens without distortion.

        Args:
            matrix: (3, 3) float64 [px]: fx, fy on the diagonal, cx, cy in the last column.
            width: [px]
            height: [px]
        """
        x = np.broadcast_to((np.arange(width) - matrix[0, 2]) / matrix[0, 0], (height, width))
        y = np.broadcast_to(((np.arange(height) - matrix[1, 2]) / matrix[1, 1])[:, None], (height, width))
        return cls(x.astype(np.float32, order="C"), y.astype(np.float32, order="C"))

    def points(self, depth: npt.NDArray[np.uint16], scale_m: float = 0.001) -> Float32:
        """Compute the points of a depth image.

        Args:
            depth: (H, W) uint16 distance along the optical axis; 0 where there is none.
            scale_m: Metres per unit of `depth`.

        Returns:
            (H, W, 3) float32 [m], optical frame, NaN in all three where there is no depth.

        Raises:
            CameraError: If the image has another size than the lens was made for.
        """
        if depth.shape != self.x.shape:
            raise CameraError(f"depth image: shape {depth.shape} is not the lens's {self.x.shape}")
        z = depth.astype(np.float32)
        z *= np.float32(scale_m)
        z[depth == 0] = np.nan
        xyz = np.empty((*depth.shape, 3), np.float32)
        np.multiply(self.x, z, out=xyz[..., 0])
        np.multiply(self.y, z, out=xyz[..., 1])
        xyz[..., 2] = z
        return xyz
