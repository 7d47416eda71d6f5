# SPDX-License-Identifier: Apache-2.0
"""The shapes of objects by name, each in a unit box: a scene scales them to the size of its object.

P1 grasped cans and boxes, P2 a stuffed Minion, a flat ball, a sponge and a stuffed volleyball. None of their
meshes is public; these are made here from formulas, with features that a fingertip or a camera can distinguish.
All stand upright along z. Random superquadrics, vases and blobs serve to learn to generalise.
"""

from collections.abc import Callable
from functools import lru_cache
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import SimulationError
from foretouch.types import Float64, Int64
from foretouch_lab.simulation.objects.mesh import TriangleMesh, read_mesh_file

_HARMONICS = 6  # waves of a blob
_LEVEL = 5  # halvings of the icosahedron's edges: 10,242 directions
_ROUNDING = 6  # grid cells from the flat part of a box to the middle of an edge

_Surface = tuple[Float64, Int64]  # vertices and faces


def _superquadric(rng: np.random.Generator) -> TriangleMesh:
    """Make a body between box, cylinder and ellipsoid: (|x|^p + |y|^p)^(q/p) + |z|^q = 1, p and q from 2 to 8."""
    p, q = rng.uniform(2.0, 8.0, 2)
    x, y, z = np.abs(_sphere_directions() / rng.uniform(0.6, 1.0, 3)).T
    return _star_shaped(((x**p + y**p) ** (q / p) + z**q) ** (-1.0 / q))


def _vase(rng: np.random.Generator) -> TriangleMesh:
    """Return a turned profile with bellies and necks, at least 25 mm where the box is 100 mm."""
    height = np.linspace(0.0, 1.0, 48)
    waves = sum(rng.normal(0.0, 0.22 / k) * np.cos(np.pi * k * height + rng.uniform(0.0, 6.28)) for k in range(1, 5))
    radius = np.clip(0.4 + waves, 0.18, 0.75)
    rim = 0.04 * np.sqrt(np.linspace(0.0, 1.0, 8)[1:])  # rounds the two ends off
    radius[:7] *= 0.92 + 2.0 * rim
    radius[-7:] *= (0.92 + 2.0 * rim)[::-1]
    return _revolved(np.concatenate([[(0.0, 0.0)], np.stack([radius, height], axis=1), [(0.0, 1.0)]]))


def _blob(rng: np.random.Generator) -> TriangleMesh:
    """Return a ball with smooth waves in random directions."""
    axes = rng.standard_normal((_HARMONICS, 3))
    axes *= (rng.uniform(1.0, 4.0, _HARMONICS) / np.linalg.norm(axes, axis=1))[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, _HARMONICS)
    height = rng.uniform(0.02, 0.14, _HARMONICS)
    stretch = rng.uniform(0.6, 1.0, 3)
    d = _sphere_directions()
    ellipsoid = 1.0 / np.linalg.norm(d / stretch, axis=1)
    return _star_shaped(ellipsoid * (1.0 + np.sin(d @ axes.T + phase) @ height))


def _can() -> TriangleMesh:
    """Make a tin: a straight wall between two bevelled rims, its lids sunk."""
    wall = np.linspace(0.045, 0.955, 9)
    profile = [(0.0, 0.02), (0.46, 0.02), (0.47, 0.0), (0.49, 0.0), (0.5, 0.015), (0.5, 0.03)]
    profile += [(0.495, z) for z in wall]
    profile += [(0.5, 0.97), (0.5, 0.985), (0.49, 1.0), (0.47, 1.0), (0.46, 0.98), (0.0, 0.98)]
    return _revolved(profile)


def _box() -> TriangleMesh:
    """Make a carton."""
    return _rounded_box(0.025)


def _ball() -> TriangleMesh:
    """Make a ball; an ellipsoid if the edges of the object differ."""
    return _star_shaped(np.full(len(_sphere_directions()), 0.5))


def _flat_ball() -> TriangleMesh:
    """Make a deflated ball: it bulges near the table, and its top has caved in."""
    d = _sphere_directions()
    cave = 0.30 * np.exp(-((np.arccos(np.clip(d[:, 2], -1.0, 1.0)) / 0.55) ** 2))
    folds = 0.015 * np.cos(5.0 * np.arctan2(d[:, 1], d[:, 0])) * (1.0 - d[:, 2] ** 2)
    return _star_shaped(0.5 - cave * 0.5 + folds)


def _sponge() -> TriangleMesh:
    """Make a block with soft edges and a waist, its surface wavy at the scale of a fingertip."""
    block = _rounded_box(0.12, cells=40)
    x, y, z = block.vertices.T
    waist = 1.0 - 0.10 * np.cos(np.pi * x) ** 2 * np.abs(2.0 * y) ** 3
    waves = 1.0 + 0.012 * np.sin(23.0 * x + 1.0) * np.sin(19.0 * y + 2.0) * np.sin(17.0 * z + 0.5)
    return TriangleMesh(np.stack([x * waves, y * waist * waves, z * waves], axis=1), block.faces)


def _minion() -> TriangleMesh:
    """Make a stuffed figure: a capsule with a goggle, two arms and a seam around the trousers."""
    d = _sphere_directions()
    goggle = 0.07 * _bump(d, (1.0, 0.0, 0.45), 0.28)
    arms = 0.09 * (_bump(d, (0.1, 1.0, -0.1), 0.22) + _bump(d, (0.1, -1.0, -0.1), 0.22))
    seam = 0.012 * np.exp(-(((d[:, 2] + 0.35) / 0.05) ** 2))
    return _star_shaped(_capsule_radius(d, 0.5, 0.42) + goggle + arms - seam)


def _volleyball() -> TriangleMesh:
    """Make a stuffed ball of six panels: three seams along great circles, and two finer ones within each panel."""
    d = _sphere_directions()
    ordered = np.sort(np.abs(d), axis=1)
    between_panels = ordered[:, 2] - ordered[:, 1]
    along = np.take_along_axis(d, ((np.argmax(np.abs(d), axis=1) + 1) % 3)[:, None], axis=1)[:, 0]
    strips = np.abs(np.abs(along) - 0.22)
    seams = 0.012 * np.exp(-((between_panels / 0.05) ** 2)) + 0.006 * np.exp(-((strips / 0.035) ** 2))
    return _star_shaped(0.5 - seams)


BUILDERS: Final[dict[str, Callable[[], TriangleMesh]]] = {
    build.__name__[1:]: build for build in (_ball, _box, _can, _flat_ball, _minion, _sponge, _volleyball)
}
#: Names that a scene may use; `random` is a family with a member for each number.
SHAPES: Final = (*BUILDERS, "random")


@lru_cache(maxsize=256)
def unit_mesh(shape: str, variant: int = 0) -> TriangleMesh:
    """Return a closed mesh in [-0.5, 0.5]³, upright along z.

    Args:
        shape: Out of `SHAPES`, or the SHA-256 of a mesh file and its path, with a colon between them.
        variant: Member of the family `random`; the others have one.

    Raises:
        SimulationError: If the file has changed since its hash was made.
        FileError: If it cannot be used.
    """
    if shape == "random":
        rng = np.random.default_rng([0x5EED, variant])
        mesh = (_superquadric, _vase, _blob)[rng.integers(3)](rng)
    elif shape in BUILDERS:
        mesh = BUILDERS[shape]()
    else:
        sha256, _, path = shape.partition(":")
        mesh, digest = read_mesh_file(path)
        if digest != sha256:
            raise SimulationError(f"{path}: has changed since the scene was read", "mesh")
    return mesh.in_unit_box()


def _capsule_radius(d: Float64, half_height: float, radius: float) -> Float64:
    """Return the distance of an upright capsule's surface along unit directions (n, 3)."""
    straight = half_height - radius  # from the middle to the centre of a cap
    across = np.hypot(d[:, 0], d[:, 1])
    wall = radius / np.maximum(across, 1e-9)
    on_wall = wall * np.abs(d[:, 2]) <= straight
    cap = straight * np.abs(d[:, 2]) + np.sqrt(np.maximum(radius**2 - (straight * across) ** 2, 0.0))
    return np.where(on_wall, wall, cap)


def _bump(d: Float64, towards: tuple[float, float, float], width: float) -> Float64:
    """Return a smooth hill of height 1 about one direction; `width` is in radians."""
    axis = np.asarray(towards) / np.linalg.norm(towards)
    return np.asarray(np.exp(-((np.arccos(np.clip(d @ axis, -1.0, 1.0)) / width) ** 2)), np.float64)


def _revolved(profile: npt.ArrayLike) -> TriangleMesh:
    """Turn a profile (n, 2) of radius and height about z; its ends, the poles, have radius 0, all others more."""
    segments = 256  # around the axis; on a radius of 35 mm the facets leave the circle by 3 µm
    radius, height = np.asarray(profile, np.float64).T
    angle = np.arange(segments) * (2.0 * np.pi / segments)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = np.concatenate(
        [radius[1:-1, None, None] * circle, np.broadcast_to(height[1:-1, None, None], (len(height) - 2, segments, 1))],
        axis=2,
    )
    vertices = np.concatenate([[(0.0, 0.0, height[0]), (0.0, 0.0, height[-1])], rings.reshape(-1, 3)])
    index = 2 + np.arange(rings.shape[0] * segments).reshape(-1, segments)
    following = np.roll(index, -1, axis=1)
    bands = [_quads(index[:-1], following[:-1], following[1:], index[1:])]
    low = np.stack([np.zeros(segments, np.int64), following[0], index[0]], axis=1)
    high = np.stack([np.ones(segments, np.int64), index[-1], following[-1]], axis=1)
    return TriangleMesh(vertices, np.concatenate([low, high, *bands]))


def _star_shaped(radius: Float64) -> TriangleMesh:
    """Return a surface that is seen whole from the origin, by its distance (V,) along `_sphere_directions`, positive."""
    directions, faces = _sphere()
    return TriangleMesh(directions * radius[:, None], faces)


def _sphere_directions() -> Float64:
    """Return (V, 3) float64 unit vectors, evenly over the sphere."""
    return _sphere()[0]


def _rounded_box(edge_radius: float, cells: int = 6) -> TriangleMesh:
    """Return a unit cube, its edges and corners rounded, with a number of cells across the flat part of a face."""
    inner = 0.5 - edge_radius
    # Equal angles on the rounding: tan spaces the grid so that normals turn by equal steps.
    bend = inner + edge_radius * np.tan(np.linspace(0.0, np.pi / 4.0, _ROUNDING + 1)[1:])
    line = np.concatenate([-bend[::-1], np.linspace(-inner, inner, cells + 1), bend])
    u, v = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    index = np.arange(len(u)).reshape(len(line), len(line))
    quads = _quads(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    sides: list[Float64] = []
    faces: list[Int64] = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            side = np.empty((len(u), 3))
            side[:, axis] = sign * 0.5
            side[:, (axis + 1) % 3] = u
            side[:, (axis + 2) % 3] = v
            faces.append(len(sides) * len(u) + (quads if sign > 0.0 else quads[:, ::-1]))
            sides.append(side)
    # Points of two sides that coincide within rounding become one.
    points = np.concatenate(sides)
    _, first, place = np.unique(
        np.round(points / np.abs(points).max(), 9), axis=0, return_index=True, return_inverse=True
    )
    points, triangles = points[first], np.asarray(place.reshape(-1)[np.concatenate(faces)], np.int64)
    core = np.clip(points, -inner, inner)
    outward = points - core
    return TriangleMesh(core + edge_radius * outward / np.linalg.norm(outward, axis=1, keepdims=True), triangles)


@lru_cache(maxsize=1)
def _sphere() -> _Surface:
    """Return unit vectors of a subdivided icosahedron and its faces: (V, 3) float64 and (F, 3) int64; do not write to them."""
    golden = (1.0 + 5.0**0.5) / 2.0
    ring = [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)]
    corners = [(a, b, 0.0) for a, b in ring] + [(0.0, a, b) for a, b in ring] + [(b, 0.0, a) for a, b in ring]
    vertices = np.array(corners)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    faces = _hull_faces(vertices)
    for _ in range(_LEVEL):
        vertices, faces = _halved(vertices, faces)
    return vertices, faces


def _hull_faces(vertices: Float64) -> Int64:
    """Return the 20 faces of an icosahedron: triples of corners one edge apart, turned outwards."""
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=2) < 1.1  # the edge is 1.05
    triples = [(i, j, k) for i, j, k in combinations(range(12), 3) if near[i, j] and near[j, k] and near[i, k]]
    faces = np.array(triples, np.int64)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", a, np.cross(b, c)) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _halved(vertices: Float64, faces: Int64) -> _Surface:
    """Return each triangle as four, the new corners pushed onto the unit sphere."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, place = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[unique].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = (len(vertices) + place.reshape(3, -1)).astype(np.int64)
    a, b, c = faces.T
    fine = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.concatenate([vertices, middle]), np.concatenate([np.stack(f, axis=1) for f in fine])


def _quads(a: Int64, b: Int64, c: Int64, d: Int64) -> Int64:
    """Return two triangles for each quadrilateral a b c d."""
    first = np.stack([a, b, c], axis=-1).reshape(-1, 3)
    return np.concatenate([first, np.stack([a, c, d], axis=-1).reshape(-1, 3)])
