# SPDX-License-Identifier: Apache-2.0
"""Where a simulated depth camera stands and what each of its pixels looks along.

The world has its origin on the table top, z up. The camera frame is the optical one (x right,
y down, z forward).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from foretouch.camera.deproject import pinhole_matrix
from foretouch.types import Float64

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
        """A camera that looks at the origin of the world.

        Args:
            width: [px]
            height: [px]
            distance_m: From the origin [m].
            tilt_rad: Between its axis and the vertical; 0 looks straight down [rad].
            hfov_deg: Horizontal field of view [deg]; by default that of a D415.
        """
        sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
        forward = np.array([0.0, sine, -cosine])
        right = np.array([1.0, 0.0, 0.0])
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        return cls(width, height, pinhole_matrix(width, height, hfov_deg), -distance_m * forward, rotation)

    def directions(self, window: Window = (slice(None), slice(None))) -> Float64:
        """(h, w, 3) float64 ray of each pixel in the world, one metre deep in the camera frame."""
        x = (np.arange(self.width)[window[1]] - self.matrix[0, 2]) / self.matrix[0, 0]
        y = (np.arange(self.height)[window[0]] - self.matrix[1, 2]) / self.matrix[1, 1]
        axes = self.R_world_camera
        rays: Float64 = (x[:, None] * axes[:, 0])[None] + (y[:, None] * axes[:, 1])[:, None] + axes[:, 2]
        return rays

    def to_camera(self, points: Float64) -> Float64:
        """Points (..., 3) of the world in the camera frame [m]."""
        return np.asarray((points - self.eye) @ self.R_world_camera, np.float64)

    def to_world(self, points: Float64) -> Float64:
        """Points (..., 3) of the camera frame in the world [m]."""
        return np.asarray(points @ self.R_world_camera.T + self.eye, np.float64)

    def bounds(self, points: Float64) -> Float64:
        """(2, 2) float64 smallest and largest (column, row) of (n, 3) points; the whole line of sight if one is behind."""
        local = self.to_camera(points)
        if (local[:, 2] <= 0.0).any():
            return np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
        pixels = (local @ self.matrix.T)[:, :2] / local[:, 2:]
        return np.stack([pixels.min(axis=0), pixels.max(axis=0)])

    def window(self, points: Float64) -> Window:
        """The pixels that can see the convex hull of points (n, 3)."""
        (left, top), (right, bottom) = self.bounds(points)
        columns = slice(int(max(0.0, np.floor(left))), int(min(self.width, np.ceil(right) + 1.0)))
        return slice(int(max(0.0, np.floor(top))), int(min(self.height, np.ceil(bottom) + 1.0))), columns

    def table_plane(self) -> Float64:
        """(4,) float64 a, b, c, d of the table top in the camera frame, the normal towards the camera."""
        return np.append(self.R_world_camera[2], self.eye[2])
