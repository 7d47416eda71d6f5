# SPDX-License-Identifier: Apache-2.0
"""Depth images to organised clouds, for every camera of this package: real, recorded or simulated.

The direction of each pixel depends on the lens only, so it is computed once (in double precision,
rounded once to float32) and every frame costs two multiplications a pixel. `librealsense` computes
the same in float32 throughout; the two differ by float32 rounding only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.errors import CameraError
from foretouch.types import Float32, Float64

__all__ = ["Deprojector", "pinhole_matrix"]


def pinhole_matrix(width: int, height: int, hfov_deg: float = 65.0) -> Float64:
    """(3, 3) float64 intrinsics of square pixels and a centred axis; 65 degrees are the D415's.

    Args:
        width: [px]
        height: [px]
        hfov_deg: Horizontal field of view [deg]; f = W / (2 tan(HFOV / 2)).
    """
    focal = width / (2.0 * np.tan(np.radians(hfov_deg) / 2.0))
    return np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Deprojector:
    """Pixel directions of one lens.

    Attributes:
        x: (H, W) float32, x / z of each pixel in the optical frame.
        y: (H, W) float32, y / z of each pixel.
    """

    x: Float32
    y: Float32

    @classmethod
    def pinhole(cls, matrix: Float64, width: int, height: int) -> Deprojector:
        """Of a lens without distortion.

        Args:
            matrix: (3, 3) float64 [px]: fx, fy on the diagonal, cx, cy in the last column.
            width: [px]
            height: [px]
        """
        columns = (np.arange(width) - matrix[0, 2]) / matrix[0, 0]
        rows = (np.arange(height) - matrix[1, 2]) / matrix[1, 1]
        x, y = np.broadcast_arrays(columns[None, :].astype(np.float32), rows[:, None].astype(np.float32))
        return cls(np.ascontiguousarray(x), np.ascontiguousarray(y))

    def points(self, depth: npt.NDArray[np.uint16], scale_m: float = 0.001) -> Float32:
        """Points of a depth image.

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
