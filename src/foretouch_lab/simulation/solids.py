# SPDX-License-Identifier: Apache-2.0
"""Solids for ray casting: meshes with a size and a pose.

A mesh stays in its unit box, and rays are transformed there instead: the search tree is built once a shape, for all
sizes and poses. A ray's parameter t is the same in both frames, since the map between them is linear.

A ray is o + t·d. The direction is not normalised: with d_z = 1 in the camera's optical frame, t is
the depth itself. All is float64; a ray that misses has t = inf.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from foretouch.types import Float32, Float64
from foretouch_lab.simulation.objects import TriangleMesh, unit_mesh

_MISS = 1e30  # embree answers 1e37 where a ray meets nothing
_UNIT_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])

#: Rotation of a body that lies on its side: its z along the table.
LYING = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def about_z(angle: float) -> Float64:
    """Return (3, 3) rotation about the vertical by an angle [rad]."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def footprint_m(solid: "Body") -> float:
    """Return the radius of a vertical cylinder about a solid's middle that holds it [m]."""
    return float(np.linalg.norm((solid.corners() - solid.position)[:, :2], axis=1).max())


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays first meet a body."""

    t: Float64  # (n,) float64, ray parameter; inf where there is nothing
    normal: Float32  # (n, 3) float32, of the unit mesh's face, of any length; meaningless where there is nothing


@dataclass(frozen=True, eq=False)
class Body:
    """A solid in the world."""

    shape: str  # name of its shape
    variant: int  # member of the family
    size: Float64  # (3,) float64, edges of the bounding box in its own frame [m]
    position: Float64  # (3,) float64, middle of that box in the world [m]
    rotation: Float64  # (3, 3) float64, its axes as columns in the world

    @property
    def mesh(self) -> TriangleMesh:
        """Its mesh in the unit box."""
        return unit_mesh(self.shape, self.variant)

    def corners(self) -> Float64:
        """Return (8, 3) float64, corners of its bounding box in the world [m]."""
        return self.position + (_UNIT_CORNERS * self.size) @ self.rotation.T

    def cast(self, origins: Float64, directions: Float64) -> Hits:
        """First hits of rays from outside.

        Args:
            origins: (3,) or (n, 3) float64, world [m].
            directions: (n, 3) float64, world, of any length: t counts in that length.
        """
        to_unit = self.rotation / self.size  # world vectors times this are vectors of the unit box
        start = ((origins - self.position) @ to_unit).astype(np.float32)
        along = (directions @ to_unit).astype(np.float32)
        start = np.ascontiguousarray(np.broadcast_to(start, along.shape))
        answer = _search_tree(self.shape, self.variant).run(start, along, output=1)
        t = answer["tfar"].astype(np.float64)
        return Hits(np.where(t < _MISS, t, np.inf), answer["Ng"])

    def world_normals(self, normal: Float32) -> Float64:
        """Return normals of unit-box faces (n, 3) as outward unit normals (n, 3) float64 in the world."""
        turned = (normal / self.size) @ self.rotation.T  # normals go by the inverse transpose
        return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True), np.float64)

    def lowest(self) -> float:
        """Return the height of its lowest point in the world [m]."""
        return float(self.position[2] + (self.mesh.vertices @ (self.size * self.rotation[2])).min())


@lru_cache(maxsize=256)
def _search_tree(shape: str, variant: int) -> Any:
    from embreex.mesh_construction import TriangleMesh as EmbreeMesh
    from embreex.rtcore_scene import EmbreeScene

    mesh = unit_mesh(shape, variant)
    scene = EmbreeScene(robust=True)  # watertight along edges: no ray slips into the body
    EmbreeMesh(scene, mesh.vertices[mesh.faces].astype(np.float32))
    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # builds the tree now
    return scene
