# SPDX-License-Identifier: Apache-2.0
"""Boxes, cylinders and spheres that rays can be cast against in closed form.

A ray is o + t·d. The direction is not normalised: with d_z = 1 in the camera's optical frame, t is
the depth itself. All is float64; a ray that misses has t = inf.
"""

import itertools
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from foretouch.types import Float64


@dataclass(frozen=True, eq=False, kw_only=True)
class Primitive(ABC):
    """A solid with a pose.

    Attributes:
        position: (3,) float64, its centre in the world [m].
        rotation: (3, 3) float64, its axes as columns in the world.
    """

    position: Float64
    rotation: Float64 = field(default_factory=lambda: np.eye(3))

    @property
    @abstractmethod
    def half_extents(self) -> Float64:
        """(3,) float64, half of the bounding box along its own axes [m]."""

    @abstractmethod
    def _cast(self, origin: Float64, directions: Float64) -> Float64:
        """`cast` in the solid's own frame, (n, 3) to (n,)."""

    def cast(self, origin: Float64, directions: Float64) -> Float64:
        """Where rays enter the solid.

        Args:
            origin: (3,) float64, world [m], outside the solid.
            directions: (..., 3) float64, world, of any length.

        Returns:
            (...) float64, t of the first hit, inf where there is none.
        """
        flat = directions.reshape(-1, 3) @ self.rotation
        t = self._cast((origin - self.position) @ self.rotation, flat)
        return t.reshape(directions.shape[:-1])

    def corners(self) -> Float64:
        """(8, 3) float64, corners of its oriented bounding box, world [m]."""
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        return self.position + (signs * self.half_extents) @ self.rotation.T

    def footprint_m(self) -> float:
        """Radius of a vertical cylinder about its centre that holds it [m]."""
        return float(np.linalg.norm((self.corners() - self.position)[:, :2], axis=1).max())

    def moved(self, offset: Float64) -> Self:
        """The same solid, shifted by (3,) in the world [m]."""
        return replace(self, position=self.position + offset)


@dataclass(frozen=True, eq=False, kw_only=True)
class Box(Primitive):
    """A cuboid.

    Attributes:
        size: (3,) float64, full edge lengths [m].
    """

    size: Float64

    @property
    def half_extents(self) -> Float64:
        """(3,) float64 [m]."""
        return np.asarray(self.size) / 2.0

    def _cast(self, origin: Float64, directions: Float64) -> Float64:
        near, far = _slab(origin, directions, self.half_extents)
        return _first(near.max(axis=1), far.min(axis=1))


@dataclass(frozen=True, eq=False, kw_only=True)
class Cylinder(Primitive):
    """A solid cylinder about its own z axis.

    Attributes:
        radius: [m]
        height: [m]
    """

    radius: float
    height: float

    @property
    def half_extents(self) -> Float64:
        """(3,) float64 [m]."""
        return np.array([self.radius, self.radius, self.height / 2.0])

    def _cast(self, origin: Float64, directions: Float64) -> Float64:
        near, far = _slab(origin[2:], directions[:, 2:], self.half_extents[2:])  # between the caps
        side_near, side_far = _ball(origin[:2], directions[:, :2], self.radius)  # within the mantle
        return _first(np.maximum(near[:, 0], side_near), np.minimum(far[:, 0], side_far))


@dataclass(frozen=True, eq=False, kw_only=True)
class Sphere(Primitive):
    """A ball.

    Attributes:
        radius: [m]
    """

    radius: float

    @property
    def half_extents(self) -> Float64:
        """(3,) float64 [m]."""
        return np.full(3, self.radius)

    def _cast(self, origin: Float64, directions: Float64) -> Float64:
        return _first(*_ball(origin, directions, self.radius))


def _slab(origin: Float64, directions: Float64, half: Float64) -> tuple[Float64, Float64]:
    """Where rays enter and leave |x_i| <= half_i, each (n, k); a parallel ray is always in or never."""
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (-half - origin) / directions
        high = (half - origin) / directions
    near, far = np.fmin(low, high), np.fmax(low, high)
    parallel = directions == 0.0
    if parallel.any():
        inside = np.broadcast_to(np.abs(origin) <= half, parallel.shape)
        near = np.where(parallel, np.where(inside, -np.inf, np.inf), near)
        far = np.where(parallel, np.where(inside, np.inf, -np.inf), far)
    return near, far


def _ball(origin: Float64, directions: Float64, radius: float) -> tuple[Float64, Float64]:
    """Where rays enter and leave |x| <= radius, each (n,), in 2-D (a mantle) or 3-D (a ball)."""
    a = np.einsum("ij,ij->i", directions, directions)
    b = directions @ origin
    c = float(origin @ origin) - radius**2
    discriminant = b * b - a * c
    hit = (discriminant >= 0.0) & (a > 0.0)
    root = np.sqrt(np.where(hit, discriminant, 0.0))
    scale = np.where(a > 0.0, a, 1.0)
    near = np.where(hit, (-b - root) / scale, np.inf)
    far = np.where(hit, (-b + root) / scale, -np.inf)
    along = (a == 0.0) & (c <= 0.0)  # parallel to a cylinder's axis, inside its mantle
    return np.where(along, -np.inf, near), np.where(along, np.inf, far)


def _first(near: Float64, far: Float64) -> Float64:
    """Entry of a convex solid in front of the eye, inf where the ray misses it."""
    return np.where((near <= far) & (near > 0.0), near, np.inf)
