# SPDX-License-Identifier: Apache-2.0
"""Depth images to organised clouds, for all cameras of this package: real, recorded or simulated.

The direction of each pixel depends on the lens only, so it is computed once (in double precision,
rounded once to float32) and each frame takes two multiplications per pixel. `librealsense` computes
the same in float32 throughout; the two differ by float32 rounding only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CameraError
from foretouch.types import Float32, Float64

_MODELS = ("brown_conrady", "inverse_brown_conrady")
_ITERATIONS = 10  # as in librealsense
_UNDONE = 1e-3  # largest change of x/z and y/z in the last iteration: 1 mm at 1 m


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
    def of_lens(
        cls, matrix: Float64, width: int, height: int, model: str = "none", coefficients: Sequence[float] = (0.0,) * 5
    ) -> Self:
        """Make the deprojector of a lens as librealsense describes it; by default without distortion.

        Args:
            matrix: (3, 3) float64 [px]: fx, fy on the diagonal, cx, cy in the last column.
            width: [px]
            height: [px]
            model: `none`, `brown_conrady` or `inverse_brown_conrady`.
            coefficients: k1, k2, p1, p2, k3 of Brown's model.

        Raises:
            CameraError: If another model has coefficients that are not zero, or the distortion is too strong to be
                undone.
        """
        x = np.broadcast_to((np.arange(width) - matrix[0, 2]) / matrix[0, 0], (height, width))
        y = np.broadcast_to(((np.arange(height) - matrix[1, 2]) / matrix[1, 1])[:, None], (height, width))
        if model != "none" and any(coefficients):
            if model not in _MODELS:
                raise CameraError(f"distortion model {model}: cannot be deprojected, only {', '.join(_MODELS)}")
            x, y = _undistort(x, y, np.asarray(coefficients, np.float64), scaled_shift=model == "inverse_brown_conrady")
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


def _undistort(x: Float64, y: Float64, k: Float64, *, scaled_shift: bool) -> tuple[Float64, Float64]:
    """Undistort normalised coordinates (H, W) by fixed-point iteration, as librealsense's rsutil.h does.

    With `scaled_shift`, the tangential shift is computed from the point times its radial factor: the only difference
    between the library's two models. That an iteration does not converge is a `CameraError`; the library ignores it.
    """
    straight_x, straight_y = last_x, last_y = x, y
    with np.errstate(all="ignore"):  # a diverging iteration overflows
        for _ in range(_ITERATIONS):
            last_x, last_y = straight_x, straight_y
            r2 = last_x * last_x + last_y * last_y
            radial = 1.0 + ((k[4] * r2 + k[1]) * r2 + k[0]) * r2
            at_x, at_y = (one * (radial if scaled_shift else 1.0) for one in (last_x, last_y))
            straight_x = (x - (2.0 * k[2] * at_x * at_y + k[3] * (r2 + 2.0 * at_x * at_x))) / radial
            straight_y = (y - (2.0 * k[3] * at_x * at_y + k[2] * (r2 + 2.0 * at_y * at_y))) / radial
        change = float(np.maximum(np.abs(straight_x - last_x), np.abs(straight_y - last_y)).max(initial=0.0))
    if not change <= _UNDONE:
        raise CameraError(
            f"distortion {k.tolist()}: is not undone by {_ITERATIONS} iterations: the last changes a ray by {change:.3g}, "
            f"{_UNDONE:g} is allowed"
        )
    return straight_x, straight_y
