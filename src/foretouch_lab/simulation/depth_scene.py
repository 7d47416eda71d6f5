# SPDX-License-Identifier: Apache-2.0
"""A simulated depth camera (D415): where it stands, and what its stereo adds to exact depth.

The world has its origin on the table top, z up. The camera frame is the optical one (x right,
y down, z forward).
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from foretouch.types import Bool, Cloud, Float64, Int32, UInt8

Window = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class CameraView:
    """A pinhole camera in the world."""

    width: int  # [px]
    height: int  # [px]
    matrix: Float64  # (3, 3) float64, intrinsics [px]
    eye: Float64  # (3,) float64, its optical centre in the world [m]
    R_world_camera: Float64  # (3, 3) float64, its axes as columns in the world

    @classmethod
    def towards_table(cls, width: int, height: int, distance_m: float, tilt_rad: float, hfov_deg: float = 65.0) -> Self:
        """Return a camera of square pixels and a centred axis that looks at the origin of the world.

        Args:
            width: [px]
            height: [px]
            distance_m: From the origin [m].
            tilt_rad: Between its axis and the vertical; 0 looks straight down [rad].
            hfov_deg: Horizontal field of view [deg]; by default of a D415.
        """
        sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
        forward = np.array([0.0, sine, -cosine])
        right = np.array([1.0, 0.0, 0.0])
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        # Rounded to float32 as a device stores it, so that frames sent through one stay bit-equal.
        focal = float(np.float32(width / (2.0 * np.tan(np.radians(hfov_deg) / 2.0))))
        matrix = np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])
        return cls(width, height, matrix, -distance_m * forward, rotation)

    def directions(self, window: Window = (slice(None), slice(None))) -> Float64:
        """Return (h, w, 3) float64 ray of each pixel in the world, one metre deep in the camera frame."""
        x = (np.arange(self.width)[window[1]] - self.matrix[0, 2]) / self.matrix[0, 0]
        y = (np.arange(self.height)[window[0]] - self.matrix[1, 2]) / self.matrix[1, 1]
        axes = self.R_world_camera
        rays: Float64 = (x[:, None] * axes[:, 0])[None] + (y[:, None] * axes[:, 1])[:, None] + axes[:, 2]
        return rays

    def to_camera(self, points: Float64) -> Float64:
        """Return points (..., 3) of the world in the camera frame [m]."""
        return np.asarray((points - self.eye) @ self.R_world_camera, np.float64)

    def to_world(self, points: Float64) -> Float64:
        """Return points (..., 3) of the camera frame in the world [m]."""
        return np.asarray(points @ self.R_world_camera.T + self.eye, np.float64)

    def bounds(self, points: Float64) -> Float64:
        """Return (2, 2) float64 smallest and largest (column, row) of (n, 3) points; the whole line of sight if one is behind."""
        local = self.to_camera(points)
        if (local[:, 2] <= 0.0).any():
            return np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
        pixels = (local @ self.matrix.T)[:, :2] / local[:, 2:]
        return np.stack([pixels.min(axis=0), pixels.max(axis=0)])

    def window(self, points: Float64) -> Window:
        """Return the pixels that can see the convex hull of points (n, 3)."""
        (left, top), (right, bottom) = self.bounds(points)
        columns = slice(int(max(0.0, np.floor(left))), int(min(self.width, np.ceil(right) + 1.0)))
        return slice(int(max(0.0, np.floor(top))), int(min(self.height, np.ceil(bottom) + 1.0))), columns

    def table_plane(self) -> Float64:
        """Return (4,) float64 a, b, c, d of the table top in the camera frame, the normal towards the camera."""
        return np.append(self.R_world_camera[2], self.eye[2])


D415_BASELINE_M = 0.055  # distance of the imagers
FLYING_SHARE = 0.5  # of the pixels of a depth edge that lie between both sides
HOLE_SHARE = 0.01  # of the pixels that lie in random spots without depth
GRAZING_DEG = 80.0  # angle between ray and surface normal beyond which there is no depth
_MATCHING_WINDOW_PX = 9  # side of the block that stereo matching compares
_EDGE_M = 0.02  # a 3x3 window that spans more than this holds a depth edge


def add_stereo_noise(depth: Float64, noise_m: float, rng: np.random.Generator) -> Float64:
    """Add noise that grows with the square of the depth and is correlated over the matching window.

    A constant sub-pixel error s of the disparity gives sigma_z = s·z² / (f·B).

    Args:
        depth: (H, W) float64 [m], inf without a surface.
        noise_m: Standard deviation at a depth of 1 m [m].
        rng: Of the noise.

    Returns:
        (H, W) float64 [m].
    """
    from scipy.ndimage import uniform_filter

    # The mean of k x k independent values has 1/k of their deviation; wrapping keeps it so at the border.
    noise = _MATCHING_WINDOW_PX * uniform_filter(rng.standard_normal(depth.shape), _MATCHING_WINDOW_PX, mode="wrap")
    finite = np.isfinite(depth)
    return np.where(finite, depth + noise_m * np.where(finite, depth, 0.0) ** 2 * noise, np.inf)


def add_flying_pixels(depth: Float64, rng: np.random.Generator) -> Float64:
    """Give pixels on a depth edge a depth between the nearest and the farthest of their 3x3 window.

    Args:
        depth: (H, W) float64 [m], inf without a surface.
        rng: Of the mixing weights.

    Returns:
        (H, W) float64 [m].
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    finite = np.isfinite(depth)
    near = minimum_filter(depth, 3, mode="nearest")
    far = maximum_filter(np.where(finite, depth, -np.inf), 3, mode="nearest")
    edge = finite & (far - near > _EDGE_M)
    weight = rng.random(depth.shape)
    result = depth.copy()
    result[edge] = (weight * far)[edge] + ((1.0 - weight) * near)[edge]
    return result


def stereo_shadow(depth: Float64, focal_px: float, baseline_m: float = D415_BASELINE_M) -> Bool:
    """Return pixels that the second imager, to the right of the first, cannot see.

    A pixel at column u of the depth (H, W) [m] is seen there at u - f·B/z. It is hidden if a pixel to its right, hence
    of something nearer, is seen at the same place or farther left.

    Args:
        depth: (H, W) of the first imager [m].
        focal_px: Focal length [px].
        baseline_m: Distance of the second imager [m].
    """
    seen_at = np.arange(depth.shape[1]) - focal_px * baseline_m / depth
    leftmost = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, np.bool_)
    hidden[:, :-1] = leftmost[:, 1:] < seen_at[:, :-1]
    return hidden


TABLE: Final = 1  # label of the table; 0 is everything else
FIRST_OBJECT: Final = 2  # label of the first object
TABLE_M: Final = np.array([1.4, 1.0])  # edges of the table top about the world's origin [m]


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """One frame with its ground truth.

    Attributes:
        depth_mm: (H, W) uint16 [mm] along the optical axis, 0 without depth.
        rgb: (H, W, 3) uint8, in the same view as the depth.
        labels: (H, W) int32: 0 none or floor, 1 table, 2 and on the objects; exact, also where depth is noisy or
            absent.
        K: (3, 3) float64, intrinsics [px].
        plane: (4,) float64, the table in the camera frame, its normal towards the camera [m].
    """

    depth_mm: npt.NDArray[np.uint16]
    rgb: UInt8
    labels: Int32
    K: Float64
    plane: Float64

    def cloud(
        self, frame_id: str = "camera_depth_optical_frame", stamp_ns: int = 0, *, with_rgb: bool = False
    ) -> Cloud:
        """Return the frame as an organised cloud, NaN where there is no depth.

        Args:
            frame_id: Frame of the camera.
            stamp_ns: Time of the frame [ns].
            with_rgb: Whether the points have colours.
        """
        rgb = self.rgb if with_rgb else None
        return Cloud.from_depth(self.depth_mm, self.K, frame_id=frame_id, stamp_ns=stamp_ns, rgb=rgb)


def table_depth(view: CameraView, rays: Float64) -> Float64:
    """Return the depth of the table along rays (..., 3) of a view, inf beside it [m].

    Args:
        view: The camera.
        rays: (..., 3) in the world, one metre deep.
    """
    depth = -view.eye[2] / np.minimum(rays[..., 2], -1e-9)  # looking up never meets the table
    at = view.eye[:2] + depth[..., None] * rays[..., :2]
    return np.where((np.abs(at) <= TABLE_M / 2.0).all(axis=-1), depth, np.inf)


def to_millimetres(depth: Float64) -> npt.NDArray[np.uint16]:
    """Round depths [m] to whole millimetres, 0 without depth or where it does not fit."""
    rounded = np.rint(depth * 1000.0)
    return np.where((rounded > 0.0) & (rounded < 65536.0), rounded, 0.0).astype(np.uint16)
