# SPDX-License-Identifier: Apache-2.0
"""Solids on a table as an ideal depth camera sees them: each ray is intersected with the solid in closed form."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from foretouch.types import Cloud, Float64, Plane

_FOCAL, _WIDTH, _HEIGHT = 610.0, 640, 480  # of a D415 at 640 x 480 [pixels]
_COLUMN, _ROW = 318.3, 242.9  # where its axis meets the image: no solid is symmetric in pixels
_RIGHT = np.array([0.0, -1.0, 0.0])  # of the camera, in the world, which looks along the world's x and down

# Of an origin (3,) and directions (N, 3): where each line enters and leaves (N,), the first above the second without a hit.
Interval = Callable[[Float64, Float64], tuple[Float64, Float64]]


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid that stands on the table z = 0 of the world, over its origin."""

    interval: Interval
    height_m: float

    def cast(self, origin: Float64, along: Float64) -> Float64:
        """(N,) first distance of rays, infinite without a hit."""
        near, far = self.interval(origin, along)
        return np.where((near <= far) & (near > 0.0), near, np.inf)

    def contacts(self, middle: Float64, along: Float64) -> Float64:
        """(2, 3), where a line through the solid enters and leaves it."""
        return middle + np.concatenate(self.interval(middle, along[None]))[:, None] * along

    def normal(self, at: Float64) -> Float64:
        """(3,) outward normal at a place on a side, from three lines beside each other."""
        inwards = np.array([0.0, 0.0, self.height_m / 2.0]) - at
        first = inwards / np.linalg.norm(inwards)
        steps = np.linalg.svd(first[None])[2][1:] * 1e-5
        around = [self.contacts(at + step, first)[0] for step in (*steps, np.zeros(3))]
        normal = np.cross(around[0] - around[2], around[1] - around[2])
        return normal / np.linalg.norm(normal) * -np.sign(normal @ inwards)


@dataclass(frozen=True, eq=False)
class Camera:
    """Where the camera stands: at this elevation over the table, looking at a place above the world's origin."""

    elevation_deg: float
    distance_m: float = 0.9
    aim: tuple[float, float, float] = (0.0, 0.0, 0.05)

    @property
    def pose(self) -> tuple[Float64, Float64]:
        """Rotation (3, 3) from world to camera, and the camera's place in the world (3,) [m]."""
        e = np.radians(self.elevation_deg)
        forward = np.array([np.cos(e), 0.0, -np.sin(e)])
        return np.stack([_RIGHT, np.cross(forward, _RIGHT), forward]), np.array(self.aim) - self.distance_m * forward

    def table(self) -> Plane:
        """The table in the camera's frame."""
        rotation, eye = self.pose
        return Plane(rotation[:, 2].copy(), float(eye[2]))

    def to_world(self, xyz: Float64) -> Float64:
        """Points (..., 3) of the camera's frame in the world."""
        rotation, eye = self.pose
        return xyz @ rotation + eye

    def to_camera(self, xyz: Float64) -> Float64:
        """The reverse of `to_world`."""
        rotation, eye = self.pose
        return (xyz - eye) @ rotation.T

    def see(self, solid: Solid, *, at: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> Cloud:
        """(H, W, 3) image of the solid alone, moved and turned about the vertical; NaN where it is not seen."""
        rotation, eye = self.pose
        v, u = np.mgrid[0:_HEIGHT, 0:_WIDTH]
        rays = np.stack([(u - _COLUMN) / _FOCAL, (v - _ROW) / _FOCAL, np.ones(u.shape)], axis=-1)
        turn = about_vertical(yaw)
        distance = solid.cast((eye - np.array([*at, 0.0])) @ turn, rays.reshape(-1, 3) @ rotation @ turn)
        depth = np.where(np.isfinite(distance), distance, np.nan).reshape(u.shape)
        return Cloud((rays * depth[..., None]).astype(np.float32))


def about_vertical(yaw: float) -> Float64:
    """(3, 3) rotation about the world's z [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def box(x: float, y: float, z: float) -> Solid:
    """A box with these edges [m]."""
    half, centre = np.array([x, y, z]) / 2.0, np.array([0.0, 0.0, z / 2.0])
    return Solid(lambda origin, along: _slabs(origin - centre, along, half), z)


def _slabs(origin: Float64, along: Float64, half: Float64) -> tuple[Float64, Float64]:
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(-half - origin) / along, (half - origin) / along])
    inside = np.abs(origin) <= half
    low = np.where(np.isnan(ends[0]) | (along == 0.0), np.where(inside, -np.inf, np.inf), ends.min(axis=0))
    high = np.where(np.isnan(ends[0]) | (along == 0.0), np.where(inside, np.inf, -np.inf), ends.max(axis=0))
    return low.max(axis=1), high.min(axis=1)


def can(radius_m: float, height_m: float) -> Solid:
    """An upright cylinder."""

    def interval(origin: Float64, along: Float64) -> tuple[Float64, Float64]:
        side = _roots((along[:, :2] ** 2).sum(axis=1), along[:, :2] @ origin[:2], origin[:2] @ origin[:2] - radius_m**2)
        middle = np.array([0.0, 0.0, height_m / 2.0])
        caps = _slabs((origin - middle)[2:], along[:, 2:], np.array([height_m / 2.0]))
        return np.maximum(side[0], caps[0]), np.minimum(side[1], caps[1])

    return Solid(interval, height_m)


def ball(radius_m: float) -> Solid:
    """A ball that touches the table."""

    def interval(origin: Float64, along: Float64) -> tuple[Float64, Float64]:
        offset = origin - np.array([0.0, 0.0, radius_m])
        return _roots((along**2).sum(axis=1), along @ offset, offset @ offset - radius_m**2)

    return Solid(interval, 2.0 * radius_m)


def _roots(a: Float64, b: Float64, c: float) -> tuple[Float64, Float64]:
    """Both solutions of a t² + 2 b t + c = 0; infinite, the first above the second, without any."""
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        low, high = (-b - root) / a, (-b + root) / a
    return np.where(np.isnan(low), np.inf, low), np.where(np.isnan(high), -np.inf, high)
