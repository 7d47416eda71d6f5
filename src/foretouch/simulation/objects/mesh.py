# SPDX-License-Identifier: Apache-2.0
"""Closed triangle meshes: what rays meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from foretouch.errors import SimulationError
from foretouch.types import Float64

__all__ = ["TriangleMesh"]


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
