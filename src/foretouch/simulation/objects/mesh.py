# SPDX-License-Identifier: Apache-2.0
"""Closed triangle meshes for ray casting, and three ways to generate them: by revolving a profile, by scaling the
directions of a sphere, and by rounding a box.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from foretouch.errors import SimulationError
from foretouch.types import Float64

__all__ = ["TriangleMesh", "revolved", "rounded_box", "sphere_directions", "star_shaped"]


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A closed surface made of triangles, counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) float64 [m], or of unit extent before it is scaled.
        faces: (F, 3) int64, indices into `vertices`.
    """

    vertices: Float64
    faces: npt.NDArray[np.int64]

    @property
    def bounds(self) -> Float64:
        """(2, 3) float64, least and largest coordinates."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extents(self) -> Float64:
        """(3,) float64, edges of the bounding box."""
        return np.asarray(np.ptp(self.vertices, axis=0), np.float64)

    def volume(self) -> float:
        """Enclosed volume by the divergence theorem; negative if the faces are inside out."""
        a, b, c = self.corners()
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    @cached_property
    def centroid(self) -> Float64:
        """(3,) float64, centre of the enclosed volume."""
        a, b, c = self.corners()
        six_volumes = np.einsum("ij,ij->i", a, np.cross(b, c))
        return np.asarray(six_volumes @ (a + b + c) / (4.0 * six_volumes.sum()), np.float64)

    def corners(self) -> tuple[Float64, Float64, Float64]:
        """First, second and third corner of each face, (F, 3) float64 each."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return a, b, c

    def is_closed(self) -> bool:
        """Whether each edge lies in two faces, once in either direction."""
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        key = edges[:, 0] * len(self.vertices) + edges[:, 1]
        twin = edges[:, 1] * len(self.vertices) + edges[:, 0]
        return len(np.unique(key)) == len(key) and bool(np.isin(twin, key).all())

    def require_closed(self, name: str) -> None:
        """Refuse a surface with a hole, or one that is inside out.

        Raises:
            SimulationError: Names the mesh and what is wrong.
        """
        if not self.is_closed():
            raise SimulationError(f"{name}: the mesh has an edge that is not shared by two faces", "mesh")
        if not self.volume() > 0.0:
            raise SimulationError(f"{name}: the mesh encloses {self.volume():g} m³", "mesh")

    def in_unit_box(self) -> TriangleMesh:
        """Moved and scaled, each axis by itself, to [-0.5, 0.5]³."""
        low, high = self.bounds
        return TriangleMesh((self.vertices - (low + high) / 2.0) / (high - low), self.faces)


Directions = tuple[Float64, npt.NDArray[np.int64]]

_SEGMENTS = 256  # around the axis; on a radius of 35 mm the facets leave the circle by 3 µm
_LEVEL = 5  # halvings of the icosahedron's edges: 10,242 directions


def revolved(profile: npt.ArrayLike, segments: int = _SEGMENTS) -> TriangleMesh:
    """Turn a profile about z.

    Args:
        profile: (n, 2) radius and height from the lower to the upper pole; the ends have radius 0, all others more.
        segments: Around the axis.
    """
    radius, height = np.asarray(profile, np.float64).T
    angle = np.arange(segments) * (2.0 * np.pi / segments)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = np.concatenate(
        [
            radius[1:-1, None, None] * circle,
            np.broadcast_to(height[1:-1, None, None], (len(height) - 2, segments, 1)),
        ],
        axis=2,
    )
    poles = np.array([[0.0, 0.0, height[0]], [0.0, 0.0, height[-1]]])
    vertices = np.concatenate([poles, rings.reshape(-1, 3)])
    index = 2 + np.arange(rings.shape[0] * segments).reshape(-1, segments)
    following = np.roll(index, -1, axis=1)
    bands = [_quads(index[:-1], following[:-1], following[1:], index[1:])]
    low = np.stack([np.zeros(segments, np.int64), following[0], index[0]], axis=1)
    high = np.stack([np.ones(segments, np.int64), index[-1], following[-1]], axis=1)
    return TriangleMesh(vertices, np.concatenate([low, high, *bands]))


def star_shaped(radius: Callable[[Float64], Float64], level: int = _LEVEL) -> TriangleMesh:
    """A surface that is seen whole from the origin.

    Args:
        radius: Distance of the surface along unit directions: (V, 3) to (V,), positive.
        level: Halvings of the icosahedron's edges.
    """
    directions, faces = sphere_directions(level)
    return TriangleMesh(directions * radius(directions)[:, None], faces)


def rounded_box(size: npt.ArrayLike, edge_radius: float, cells: int = 6, rounding: int = 6) -> TriangleMesh:
    """A box whose edges and corners are rounded.

    Args:
        size: (3,) full edge lengths.
        edge_radius: Of edges and corners; less than half of each length.
        cells: Grid cells across the flat part of a face.
        rounding: Grid cells from the flat part to the middle of an edge.
    """
    half = np.asarray(size, np.float64) / 2.0
    points, faces = _cube_grid(half, edge_radius, cells, rounding)
    core = np.clip(points, -(half - edge_radius), half - edge_radius)
    outward = points - core
    vertices = core + edge_radius * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return TriangleMesh(vertices, faces)


@lru_cache(maxsize=4)
def sphere_directions(level: int) -> Directions:
    """Unit vectors of a subdivided icosahedron and its faces: (V, 3) float64 and (F, 3) int64."""
    golden = (1.0 + 5.0**0.5) / 2.0
    ring = [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)]
    corners = [(a, b, 0.0) for a, b in ring] + [(0.0, a, b) for a, b in ring] + [(b, 0.0, a) for a, b in ring]
    vertices = np.array(corners)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    faces = _hull_faces(vertices)
    for _ in range(level):
        vertices, faces = _halved(vertices, faces)
    return vertices, faces


def _hull_faces(vertices: Float64) -> npt.NDArray[np.int64]:
    """The 20 faces of an icosahedron: triples of corners one edge apart, turned outwards."""
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=2) < 1.1  # the edge is 1.05
    triples = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    faces = np.array(triples, np.int64)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", a, np.cross(b, c)) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _halved(vertices: Float64, faces: npt.NDArray[np.int64]) -> Directions:
    """Each triangle as four, the new corners pushed onto the unit sphere."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, place = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[unique].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = (len(vertices) + place.reshape(3, -1)).astype(np.int64)
    a, b, c = faces.T
    fine = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.concatenate([vertices, middle]), np.concatenate([np.stack(f, axis=1) for f in fine])


def _cube_grid(half: Float64, edge_radius: float, cells: int, rounding: int) -> Directions:
    """Points on a box's six faces, denser towards the edges, merged where faces meet."""
    lines = []
    for h in half:
        inner = h - edge_radius
        # Equal angles on the rounding: tan spaces the grid so that normals turn by equal steps.
        bend = inner + edge_radius * np.tan(np.linspace(0.0, np.pi / 4.0, rounding + 1)[1:])
        lines.append(np.concatenate([-bend[::-1], np.linspace(-inner, inner, cells + 1), bend]))
    points, faces, start = [], [], 0
    for axis in range(3):
        u, v = lines[(axis + 1) % 3], lines[(axis + 2) % 3]
        index = np.arange(len(u) * len(v)).reshape(len(u), len(v))
        quads = _quads(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
        for sign in (1.0, -1.0):
            face = np.empty((len(u) * len(v), 3))
            face[:, axis] = sign * half[axis]
            face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = (m.ravel() for m in np.meshgrid(u, v, indexing="ij"))
            points.append(face)
            faces.append(start + (quads if sign > 0.0 else quads[:, ::-1]))
            start += len(face)
    return _merged(np.concatenate(points), np.concatenate(faces))


def _merged(points: Float64, faces: npt.NDArray[np.int64]) -> Directions:
    """Points that coincide within rounding become one."""
    scale = np.abs(points).max()
    _, first, place = np.unique(np.round(points / scale, 9), axis=0, return_index=True, return_inverse=True)
    return points[first], np.asarray(place.reshape(-1)[faces], np.int64)


def _quads(
    a: npt.NDArray[np.int64], b: npt.NDArray[np.int64], c: npt.NDArray[np.int64], d: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Two triangles for each quadrilateral a b c d."""
    first = np.stack([a, b, c], axis=-1).reshape(-1, 3)
    second = np.stack([a, c, d], axis=-1).reshape(-1, 3)
    return np.concatenate([first, second])
