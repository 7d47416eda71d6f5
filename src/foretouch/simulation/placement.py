# SPDX-License-Identifier: Apache-2.0
"""Random household-sized solids that stand or lie on the table, in view and apart from each other."""

from __future__ import annotations

import numpy as np

from foretouch.errors import ConfigError
from foretouch.simulation.primitives import Box, Cylinder, Primitive, Sphere
from foretouch.simulation.view import CameraView
from foretouch.types import Float64

__all__ = ["random_objects"]

_ATTEMPTS = 200  # places tried for one object before all are thrown again
_ROUNDS = 50
_GAP_M = 0.03  # free table between two objects
_MARGIN = 0.04  # of the image, free of objects on each side


def random_objects(
    rng: np.random.Generator, view: CameraView, count: int, table_size: Float64, *, may_occlude: bool = False
) -> tuple[Primitive, ...]:
    """Solids on the table, each wholly inside the image.

    Args:
        rng: Of shapes, sizes and places.
        view: The camera.
        count: How many.
        table_size: (2,) float64, edge lengths of the table about the world's origin [m].
        may_occlude: Whether one may hide a part of another from the camera.

    Returns:
        The solids, in the world.

    Raises:
        ConfigError: If so many find no place.
    """
    for _ in range(_ROUNDS):
        placed: list[Primitive] = []
        while len(placed) < count:
            solid = _find_place(rng, view, placed, table_size, may_occlude)
            if solid is None:
                break
            placed.append(solid)
        else:
            return tuple(placed)
    raise ConfigError(f"n_objects: {count} find no place in a view of {view.width}x{view.height} pixels")


def _find_place(
    rng: np.random.Generator, view: CameraView, placed: list[Primitive], table_size: Float64, may_occlude: bool
) -> Primitive | None:
    for _ in range(_ATTEMPTS):
        solid = _random_solid(rng)
        solid = solid.moved(np.append(rng.uniform(-0.5, 0.5, 2) * table_size, 0.0))
        if not _in_view(solid, view) or not _on_table(solid, table_size):
            continue
        if any(_touch(solid, other) for other in placed):
            continue
        if may_occlude or not any(_overlap_in_image(solid, other, view) for other in placed):
            return solid
    return None


def _random_solid(rng: np.random.Generator) -> Primitive:
    """A box, a can (standing or lying) or a ball that rests on z = 0 above the origin."""
    kind = rng.integers(3)
    turn = _about_z(rng.uniform(0.0, 2.0 * np.pi))
    if kind == 0:
        size = rng.uniform((0.04, 0.04, 0.04), (0.14, 0.12, 0.18))
        return Box(position=np.array([0.0, 0.0, size[2] / 2.0]), rotation=turn, size=size)
    if kind == 1:
        radius, height = rng.uniform(0.025, 0.05), rng.uniform(0.06, 0.20)
        if rng.random() < 0.5:
            return Cylinder(position=np.array([0.0, 0.0, height / 2.0]), rotation=turn, radius=radius, height=height)
        lying = turn @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # its z along the table
        return Cylinder(position=np.array([0.0, 0.0, radius]), rotation=lying, radius=radius, height=height)
    radius = rng.uniform(0.03, 0.08)
    return Sphere(position=np.array([0.0, 0.0, radius]), radius=radius)


def _about_z(angle: float) -> Float64:
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _in_view(solid: Primitive, view: CameraView) -> bool:
    low, high = view.bounds(solid.corners())
    size = np.array([view.width, view.height], np.float64)
    return bool((low > _MARGIN * size).all() and (high < (1.0 - _MARGIN) * size).all())


def _on_table(solid: Primitive, table_size: Float64) -> bool:
    return bool((np.abs(solid.position[:2]) + solid.footprint_m() < table_size / 2.0).all())


def _touch(one: Primitive, other: Primitive) -> bool:
    distance = float(np.linalg.norm((one.position - other.position)[:2]))
    return distance < one.footprint_m() + other.footprint_m() + _GAP_M


def _overlap_in_image(one: Primitive, other: Primitive, view: CameraView) -> bool:
    """Whether the rectangles around both, one pixel in a hundred apart, share a pixel."""
    (low_a, high_a), (low_b, high_b) = view.bounds(one.corners()), view.bounds(other.corners())
    gap = 0.01 * view.width
    return bool((low_a < high_b + gap).all() and (low_b < high_a + gap).all())
