# SPDX-License-Identifier: Apache-2.0
"""Scenes of random boxes, cans and balls on a table, each ray intersected with the solid in closed form.

Household-sized solids give exact depth, labels and plane, and perhaps noise and flying pixels. The world has its origin on the
table top, z up. A ray is o + t·d. The direction is not normalised: with d_z = 1 in the camera's optical frame, t is the depth
itself. All is float64; a ray that misses has t = inf.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from foretouch.errors import ConfigError
from foretouch.types import Float32, Float64, Int32, UInt8
from foretouch_lab.simulation.depth_scene import (
    FIRST_OBJECT,
    TABLE,
    TABLE_M,
    CameraView,
    RenderedFrame,
    add_flying_pixels,
    add_stereo_noise,
    table_depth,
    to_millimetres,
)
from foretouch_lab.simulation.solids import LYING, about_z, footprint_m

_UNIT_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_FLOOR_M = 0.75  # below the table top
_ATTEMPTS = 200  # places tried for one object before all are placed anew
_ROUNDS = 50
_GAP_M = 0.03  # free table between two objects
_MARGIN = 0.04  # of the image, free of objects on each side

_COLOURS = np.array(
    [[60, 60, 66], [150, 140, 125], [196, 78, 62], [70, 130, 180], [226, 172, 63], [104, 159, 98], [150, 105, 175]],
    np.float32,
)


@dataclass(frozen=True, eq=False)
class Primitive:
    """A solid in closed form: a box, a cylinder about its own z axis, or a ball."""

    kind: Literal["box", "cylinder", "ball"]
    size: Float64  # (3,) float64, edges of the bounding box along its own axes [m]
    position: Float64  # (3,) float64, its centre in the world [m]
    rotation: Float64 = field(default_factory=lambda: np.eye(3))  # (3, 3) float64, its axes as columns in the world

    def cast(self, origin: Float64, directions: Float64) -> Float64:
        """Return where rays enter the solid.

        Args:
            origin: (3,) float64, world [m], outside the solid.
            directions: (..., 3) float64, world, of any length.

        Returns:
            (...) float64, t of the first hit, inf without a hit.
        """
        start, along = (origin - self.position) @ self.rotation, directions.reshape(-1, 3) @ self.rotation
        half = self.size / 2.0
        if self.kind == "ball":
            near, far = _ball(start, along, float(half[0]))
        else:
            own = slice(0, 3) if self.kind == "box" else slice(2, 3)  # a cylinder is between its caps
            enter, leave = _slab(start[own], along[:, own], half[own])
            near, far = enter.max(axis=1), leave.min(axis=1)
        if self.kind == "cylinder":
            enter, leave = _ball(start[:2], along[:, :2], float(half[0]))  # and within its mantle
            near, far = np.maximum(near, enter), np.minimum(far, leave)
        t = np.where((near <= far) & (near > 0.0), near, np.inf)  # in front of the eye
        return t.reshape(directions.shape[:-1])

    def corners(self) -> Float64:
        """Return (8, 3) float64, corners of its oriented bounding box, world [m]."""
        return self.position + (_UNIT_CORNERS * self.size) @ self.rotation.T


def _slab(origin: Float64, directions: Float64, half: Float64) -> tuple[Float64, Float64]:
    """Return where rays enter and leave |x_i| <= half_i, each (n, k); a parallel ray is always in or never."""
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
    """Return where rays enter and leave |x| <= radius, each (n,), in 2-D (a mantle) or 3-D (a ball)."""
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


@dataclass(frozen=True, eq=False)
class DepthScene:
    """Solids on a table above a floor, and a camera."""

    view: CameraView  # the camera
    objects: tuple[Primitive, ...]  # the solids; the k-th has the label 2 + k

    def render(
        self, rng: np.random.Generator | None = None, noise_m: float = 0.0, flying_pixels: bool = False
    ) -> RenderedFrame:
        """Render one frame; without effects it is exact to the millimetre that the depth is rounded to.

        Args:
            rng: Generator of noise and flying pixels; None leaves out both.
            noise_m: Standard deviation of the depth at 1 m, growing with its square [m].
            flying_pixels: Whether pixels on a depth edge lie between both sides.
        """
        depth, labels = self.cast()
        rgb = self._colours(depth, labels)
        if rng is not None:
            depth = add_flying_pixels(depth, rng) if flying_pixels else depth
            depth = add_stereo_noise(depth, noise_m, rng) if noise_m > 0.0 else depth
        return RenderedFrame(to_millimetres(depth), rgb, labels, self.view.matrix, self.view.table_plane())

    def cast(self) -> tuple[Float64, Int32]:
        """Return exact depth and labels.

        Returns:
            (H, W) float64 [m] along the optical axis, inf where a ray meets nothing; (H, W) int32.
        """
        rays = self.view.directions()
        table = table_depth(self.view, rays)
        labels = np.where(np.isfinite(table), TABLE, 0).astype(np.int32)
        depth = np.where(np.isfinite(table), table, -(self.view.eye[2] + _FLOOR_M) / np.minimum(rays[..., 2], -1e-9))
        for label, solid in enumerate(self.objects, FIRST_OBJECT):
            window = self.view.window(solid.corners())
            hit = solid.cast(self.view.eye, self.view.directions(window))
            nearer = hit < depth[window]
            depth[window][nearer] = hit[nearer]
            labels[window][nearer] = label
        return depth, labels

    def _colours(self, depth: Float64, labels: Int32) -> UInt8:
        """Return a colour per label, darker where the surface turns away, by the slope of the depth."""
        index = np.where(labels < FIRST_OBJECT, labels, FIRST_OBJECT + (labels - FIRST_OBJECT) % (len(_COLOURS) - 2))
        z = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        slope_v, slope_u = np.gradient(z)
        steep = np.float32(self.view.matrix[0, 0]) * np.hypot(slope_u, slope_v) / np.maximum(z, np.float32(0.1))
        shade = np.float32(1.0) / np.sqrt(np.float32(1.0) + steep * steep)
        colours: Float32 = _COLOURS[index] * (0.35 + 0.65 * shade)[..., None]
        return colours.astype(np.uint8)


def random_scene(
    rng: np.random.Generator,
    width: int = 848,
    height: int = 480,
    n_objects: int = 3,
    *,
    view: Literal["any", "oblique", "top"] = "any",
    may_occlude: bool = False,
) -> DepthScene:
    """Return boxes, cans and balls that stand or lie on a table; they do not touch and are wholly inside the image.

    Args:
        rng: Generator of everything.
        width: [px]
        height: [px]
        n_objects: How many; 0 is an empty table.
        view: Straight down, oblique (30 to 55 degrees from the vertical), or drawn, one in four straight down.
        may_occlude: Whether one object may hide a part of another.

    Raises:
        ConfigError: If the objects find no place.
    """
    tilt = 0.0 if view == "top" or (view == "any" and rng.random() < 0.25) else np.radians(rng.uniform(30.0, 55.0))
    camera = CameraView.towards_table(width, height, rng.uniform(0.8, 1.2), tilt)
    for _ in range(_ROUNDS):
        placed: list[Primitive] = []
        while len(placed) < n_objects:
            solid = _find_place(rng, camera, placed, may_occlude)
            if solid is None:
                break
            placed.append(solid)
        else:
            return DepthScene(camera, tuple(placed))
    raise ConfigError(f"n_objects: {n_objects} find no place in a view of {width}x{height} pixels")


def _find_place(
    rng: np.random.Generator, view: CameraView, placed: list[Primitive], may_occlude: bool
) -> Primitive | None:
    for _ in range(_ATTEMPTS):
        solid = _random_solid(rng)
        solid = replace(solid, position=solid.position + np.append(rng.uniform(-0.5, 0.5, 2) * TABLE_M, 0.0))
        fits = _in_view(solid, view) and (np.abs(solid.position[:2]) + footprint_m(solid) < TABLE_M / 2.0).all()
        if not fits or any(_collide(solid, other) for other in placed):
            continue
        if may_occlude or not any(_overlap_in_image(solid, other, view) for other in placed):
            return solid
    return None


def _random_solid(rng: np.random.Generator) -> Primitive:
    """Return a box, a can (standing or lying) or a ball that rests on z = 0 above the origin."""
    kind = rng.integers(3)
    turn = about_z(rng.uniform(0.0, 2.0 * np.pi))
    if kind == 0:
        size = rng.uniform((0.04, 0.04, 0.04), (0.14, 0.12, 0.18))
        return Primitive("box", size, np.array([0.0, 0.0, size[2] / 2.0]), turn)
    if kind == 1:
        radius, height = rng.uniform(0.025, 0.05), rng.uniform(0.06, 0.20)
        size = np.array([2.0 * radius, 2.0 * radius, height])
        if rng.random() < 0.5:
            return Primitive("cylinder", size, np.array([0.0, 0.0, height / 2.0]), turn)
        return Primitive("cylinder", size, np.array([0.0, 0.0, radius]), turn @ LYING)
    radius = rng.uniform(0.03, 0.08)
    return Primitive("ball", np.full(3, 2.0 * radius), np.array([0.0, 0.0, radius]))


def _in_view(solid: Primitive, view: CameraView) -> bool:
    low, high = view.bounds(solid.corners())
    size = np.array([view.width, view.height], np.float64)
    return bool((low > _MARGIN * size).all() and (high < (1.0 - _MARGIN) * size).all())


def _collide(body: Primitive, other: Primitive) -> bool:
    apart = footprint_m(body) + footprint_m(other) + _GAP_M
    return float(np.linalg.norm((body.position - other.position)[:2])) < apart


def _overlap_in_image(body: Primitive, other: Primitive, view: CameraView) -> bool:
    """Return whether the rectangles around both, one pixel in a hundred apart, share a pixel."""
    (low_a, high_a), (low_b, high_b) = view.bounds(body.corners()), view.bounds(other.corners())
    gap = 0.01 * view.width
    return bool((low_a < high_b + gap).all() and (low_b < high_a + gap).all())
