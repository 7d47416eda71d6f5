# SPDX-License-Identifier: Apache-2.0
"""Solids of the simulator on a table, as an ideal depth camera sees them: each ray is intersected with the solid in closed form."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.random_scenes import Primitive
from foretouch.types import Cloud, Float64, Plane
from foretouch_lab.simulation.depth_scene import CameraView
from foretouch_lab.simulation.solids import about_z as about_vertical

# Of a D415 at 640 x 480 [pixels]; no solid is symmetric about the pixel where its axis meets the image.
_MATRIX = np.array([[610.0, 0.0, 318.3], [0.0, 610.0, 242.9], [0.0, 0.0, 1.0]])
_RIGHT = np.array([0.0, -1.0, 0.0])  # of the camera, in the world, which looks along the world's x and down


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid that stands on the table z = 0 of the world, over its origin."""

    body: Primitive
    height_m: float

    def contacts(self, middle: Float64, along: Float64) -> Float64:
        """(2, 3), where a line through the solid enters and leaves it; `along` is of unit length."""
        starts = (middle - along, middle + along)
        t = [float(self.body.cast(start, way[None])[0]) for start, way in zip(starts, (along, -along), strict=True)]
        return np.stack([starts[0] + t[0] * along, starts[1] - t[1] * along])

    def normal(self, at: Float64) -> Float64:
        """(3,) outward normal at a place on a side, from three lines beside each other."""
        inwards = np.array([0.0, 0.0, self.height_m / 2.0]) - at
        first = inwards / np.linalg.norm(inwards)
        steps = np.linalg.svd(first[None])[2][1:] * 1e-5
        around = [self.contacts(at + step, first)[0] for step in (*steps, np.zeros(3))]
        normal = np.cross(around[0] - around[2], around[1] - around[2])
        return normal / np.linalg.norm(normal) * -np.sign(normal @ inwards)


class Camera(CameraView):
    """A camera at this elevation over the table, looking at a place above the world's origin."""

    def __init__(self, elevation_deg: float, distance_m: float = 0.9) -> None:
        e = np.radians(elevation_deg)
        forward = np.array([np.cos(e), 0.0, -np.sin(e)])
        axes = np.stack([_RIGHT, np.cross(forward, _RIGHT), forward], axis=1)
        super().__init__(640, 480, _MATRIX, np.array([0.0, 0.0, 0.05]) - distance_m * forward, axes)

    def table(self) -> Plane:
        """The table in the camera's frame."""
        return Plane.from_coefficients(self.table_plane())

    def see(self, solid: Solid, *, at: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> Cloud:
        """(H, W, 3) image of the solid alone, moved and turned about the vertical; NaN where it is not seen."""
        position = solid.body.position + np.array([*at, 0.0])
        body = replace(solid.body, rotation=about_vertical(yaw), position=position)
        rays = self.directions()
        depth = body.cast(self.eye, rays)
        depth[~np.isfinite(depth)] = np.nan
        return Cloud((rays @ self.R_world_camera * depth[..., None]).astype(np.float32))


def _standing(height_m: float) -> Float64:
    return np.array([0.0, 0.0, height_m / 2.0])


def box(x: float, y: float, z: float) -> Solid:
    """A box with these edges [m]."""
    return Solid(Primitive("box", np.array([x, y, z]), _standing(z)), z)


def can(radius_m: float, height_m: float) -> Solid:
    """An upright cylinder."""
    return Solid(
        Primitive("cylinder", np.array([2.0 * radius_m, 2.0 * radius_m, height_m]), _standing(height_m)), height_m
    )


def ball(radius_m: float) -> Solid:
    """A ball that touches the table."""
    return Solid(Primitive("ball", np.full(3, 2.0 * radius_m), _standing(2.0 * radius_m)), 2.0 * radius_m)
