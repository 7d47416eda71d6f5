# SPDX-License-Identifier: Apache-2.0
"""The shapes of objects by name, each in a unit box: a scene scales them to the size of its object.

P1 grasped cans and boxes, P2 a stuffed Minion, a flat ball, a sponge and a stuffed volleyball. None of their
meshes is public; these are made here from formulas, with features that a fingertip or a camera can distinguish.
All stand upright along z. Random superquadrics, vases and blobs  serve to learn to generalise.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Final

import numpy as np

from foretouch.errors import SimulationError
from foretouch.simulation.objects.mesh import TriangleMesh, revolved, rounded_box, sphere_directions, star_shaped
from foretouch.simulation.objects.mesh_file import read_mesh_file
from foretouch.types import Float64

_HARMONICS = 6  # waves of a blob


def _random_shape(rng: np.random.Generator) -> TriangleMesh:
    """One member, of roughly unit size; all is drawn from `rng`."""
    kind = rng.integers(3)
    return (_superquadric, _vase, _blob)[kind](rng)


def _superquadric(rng: np.random.Generator) -> TriangleMesh:
    """Between box, cylinder and ellipsoid: (|x|^p + |y|^p)^(q/p) + |z|^q = 1, p and q from 2 to 8."""
    p, q = rng.uniform(2.0, 8.0, 2)
    stretch = rng.uniform(0.6, 1.0, 3)
    x, y, z = np.abs(sphere_directions() / stretch).T
    return star_shaped(((x**p + y**p) ** (q / p) + z**q) ** (-1.0 / q))


def _vase(rng: np.random.Generator) -> TriangleMesh:
    """A turned profile with bellies and necks, at least 25 mm where the box is 100 mm."""
    height = np.linspace(0.0, 1.0, 48)
    waves = sum(rng.normal(0.0, 0.22 / k) * np.cos(np.pi * k * height + rng.uniform(0.0, 6.28)) for k in range(1, 5))
    radius = np.clip(0.4 + waves, 0.18, 0.75)
    rim = 0.04 * np.sqrt(np.linspace(0.0, 1.0, 8)[1:])  # rounds the two ends off
    radius[:7] *= 0.92 + 2.0 * rim
    radius[-7:] *= (0.92 + 2.0 * rim)[::-1]
    ring = np.stack([radius, height], axis=1)
    return revolved(np.concatenate([[(0.0, 0.0)], ring, [(0.0, 1.0)]]))


def _blob(rng: np.random.Generator) -> TriangleMesh:
    """A ball with smooth waves in random directions."""
    axes = rng.standard_normal((_HARMONICS, 3))
    axes *= (rng.uniform(1.0, 4.0, _HARMONICS) / np.linalg.norm(axes, axis=1))[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, _HARMONICS)
    height = rng.uniform(0.02, 0.14, _HARMONICS)
    stretch = rng.uniform(0.6, 1.0, 3)
    d = sphere_directions()
    ellipsoid = 1.0 / np.linalg.norm(d / stretch, axis=1)
    return star_shaped(ellipsoid * (1.0 + np.sin(d @ axes.T + phase) @ height))


def _can() -> TriangleMesh:
    """A tin: a straight wall between two bevelled rims, its lids sunk."""
    wall = np.linspace(0.045, 0.955, 9)
    profile = [(0.0, 0.02), (0.46, 0.02), (0.47, 0.0), (0.49, 0.0), (0.5, 0.015), (0.5, 0.03)]
    profile += [(0.495, z) for z in wall]
    profile += [(0.5, 0.97), (0.5, 0.985), (0.49, 1.0), (0.47, 1.0), (0.46, 0.98), (0.0, 0.98)]
    return revolved(profile)


def _box() -> TriangleMesh:
    """A carton."""
    return rounded_box((1.0, 1.0, 1.0), 0.025)


def _ball() -> TriangleMesh:
    """A ball; an ellipsoid if the edges of the object differ."""
    return star_shaped(np.full(len(sphere_directions()), 0.5))


def _flat_ball() -> TriangleMesh:
    """A deflated ball: it bulges near the table, and its top has caved in."""
    d = sphere_directions()
    cave = 0.30 * np.exp(-((np.arccos(np.clip(d[:, 2], -1.0, 1.0)) / 0.55) ** 2))
    folds = 0.015 * np.cos(5.0 * np.arctan2(d[:, 1], d[:, 0])) * (1.0 - d[:, 2] ** 2)
    return star_shaped(0.5 - cave * 0.5 + folds)


def _sponge() -> TriangleMesh:
    """A block with soft edges and a waist, its surface wavy at the scale of a fingertip."""
    block = rounded_box((1.0, 1.0, 1.0), 0.12, cells=40, rounding=6)
    x, y, z = block.vertices.T
    waist = 1.0 - 0.10 * np.cos(np.pi * x) ** 2 * np.abs(2.0 * y) ** 3
    waves = 1.0 + 0.012 * np.sin(23.0 * x + 1.0) * np.sin(19.0 * y + 2.0) * np.sin(17.0 * z + 0.5)
    return TriangleMesh(np.stack([x * waves, y * waist * waves, z * waves], axis=1), block.faces)


def _minion() -> TriangleMesh:
    """A stuffed figure: a capsule with a goggle, two arms and a seam around the trousers."""
    d = sphere_directions()
    goggle = 0.07 * _bump(d, (1.0, 0.0, 0.45), 0.28)
    arms = 0.09 * (_bump(d, (0.1, 1.0, -0.1), 0.22) + _bump(d, (0.1, -1.0, -0.1), 0.22))
    seam = 0.012 * np.exp(-(((d[:, 2] + 0.35) / 0.05) ** 2))
    return star_shaped(_capsule_radius(d, 0.5, 0.42) + goggle + arms - seam)


def _volleyball() -> TriangleMesh:
    """A stuffed ball of six panels: three seams along great circles, and two finer ones within each panel."""
    d = sphere_directions()
    ordered = np.sort(np.abs(d), axis=1)
    between_panels = ordered[:, 2] - ordered[:, 1]
    largest = np.argmax(np.abs(d), axis=1)
    along = np.take_along_axis(d, ((largest + 1) % 3)[:, None], axis=1)[:, 0]
    strips = np.abs(np.abs(along) - 0.22)
    seams = 0.012 * np.exp(-((between_panels / 0.05) ** 2)) + 0.006 * np.exp(-((strips / 0.035) ** 2))
    return star_shaped(0.5 - seams)


_BUILDERS: Final[dict[str, Callable[[], TriangleMesh]]] = {
    "ball": _ball,
    "box": _box,
    "can": _can,
    "flat_ball": _flat_ball,
    "minion": _minion,
    "sponge": _sponge,
    "volleyball": _volleyball,
}
SHAPES: Final = (*_BUILDERS, "random")
"""Names that a scene may use; `random` is a family with a member for each number."""


@lru_cache(maxsize=256)
def unit_mesh(shape: str, variant: int = 0) -> TriangleMesh:
    """A closed mesh in [-0.5, 0.5]³, upright along z.

    Args:
        shape: Out of `SHAPES`, or the SHA-256 of a mesh file and its path, with a colon between them.
        variant: Member of the family `random`; the others have one.

    Raises:
        SimulationError: If there is no such shape.
        FileError: If the file cannot be used.
    """
    if shape == "random":
        mesh = _random_shape(np.random.default_rng([0x5EED, variant]))
    elif shape in _BUILDERS:
        mesh = _BUILDERS[shape]()
    elif ":" in shape:
        sha256, _, path = shape.partition(":")
        mesh, found = read_mesh_file(path)
        if found != sha256:
            raise SimulationError(f"{path}: has changed since the scene was read", "mesh")
    else:
        raise SimulationError(f"shape: {shape!r} is none of {', '.join(SHAPES)}", "mesh")
    return mesh.in_unit_box().closed(f"{shape}[{variant}]")


def _capsule_radius(d: Float64, half_height: float, radius: float) -> Float64:
    """Distance of an upright capsule's surface along unit directions (n, 3)."""
    straight = half_height - radius  # from the middle to the centre of a cap
    across = np.hypot(d[:, 0], d[:, 1])
    wall = radius / np.maximum(across, 1e-9)
    on_wall = wall * np.abs(d[:, 2]) <= straight
    up = np.abs(d[:, 2])
    cap = straight * up + np.sqrt(np.maximum(radius**2 - (straight * across) ** 2, 0.0))
    return np.where(on_wall, wall, cap)


def _bump(d: Float64, towards: tuple[float, float, float], width: float) -> Float64:
    """A smooth hill of height 1 about one direction; `width` is in radians."""
    axis = np.asarray(towards) / np.linalg.norm(towards)
    return np.asarray(np.exp(-((np.arccos(np.clip(d @ axis, -1.0, 1.0)) / width) ** 2)), np.float64)
