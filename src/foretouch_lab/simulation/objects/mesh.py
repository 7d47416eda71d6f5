# SPDX-License-Identifier: Apache-2.0
"""Closed triangle meshes for ray casting, and their reading from files by trimesh: OBJ, PLY, STL, GLB."""

import hashlib
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from foretouch.errors import FileError, SimulationError, described
from foretouch.files import read_bytes
from foretouch.types import Float64, Int64

_SUFFIXES: Final = (".obj", ".ply", ".stl", ".glb")
_LARGEST: Final = 100_000_000  # bytes
_MOST_FACES: Final = 1_000_000

_meshes: dict[tuple[str, str], "TriangleMesh"] = {}  # by path and hash


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A closed surface made of triangles, counter-clockwise seen from outside."""

    vertices: Float64  # (V, 3) float64 [m], or of unit extent before it is scaled
    faces: Int64  # (F, 3) int64, indices into `vertices`

    @property
    def extents(self) -> Float64:
        """(3,) float64, edges of the bounding box."""
        return np.asarray(np.ptp(self.vertices, axis=0), np.float64)

    def volume(self) -> float:
        """Enclosed volume by the divergence theorem; negative if the faces are inside out."""
        a, b, c = self._corners()
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    @cached_property
    def centroid(self) -> Float64:
        """(3,) float64, centre of the enclosed volume."""
        a, b, c = self._corners()
        six_volumes = np.einsum("ij,ij->i", a, np.cross(b, c))
        return np.asarray(six_volumes @ (a + b + c) / (4.0 * six_volumes.sum()), np.float64)

    def _corners(self) -> tuple[Float64, Float64, Float64]:
        """First, second and third corner of each face, (F, 3) float64 each."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return a, b, c

    def closed(self, name: str) -> Self:
        """Itself; a `SimulationError` names the mesh and its fault if it has a hole or is inside out."""
        self._require_corners(name)
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        key = edges[:, 0] * len(self.vertices) + edges[:, 1]
        twin = edges[:, 1] * len(self.vertices) + edges[:, 0]
        ordered = np.sort(key)
        if (ordered[1:] == ordered[:-1]).any() or not np.array_equal(ordered, np.sort(twin)):
            raise SimulationError(f"{name}: the mesh has an edge that is not shared by two faces", "mesh")
        if not self.volume() > 0.0:
            raise SimulationError(f"{name}: the mesh encloses {self.volume():g} m³", "mesh")
        return self

    def in_unit_box(self) -> "TriangleMesh":
        """Moved and scaled, each axis by itself, to [-0.5, 0.5]³.

        Raises:
            SimulationError: If the mesh has no face, is flat, or a vertex is absent or not finite.
        """
        self._require_corners("mesh")
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        if not (high > low).all():
            raise SimulationError(f"mesh: has no extent along {'xyz'[int(np.argmin(high - low))]}", "mesh")
        return TriangleMesh((self.vertices - (low + high) / 2.0) / (high - low), self.faces)

    def _require_corners(self, name: str) -> None:
        """Refuse a mesh without faces, and faces whose vertices are absent or not finite."""
        if len(self.faces) == 0:
            raise SimulationError(f"{name}: the mesh has no face", "mesh")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise SimulationError(f"{name}: a face of the mesh names no vertex of the {len(self.vertices)}", "mesh")
        if not np.isfinite(self.vertices).all():
            raise SimulationError(f"{name}: a vertex of the mesh is not finite", "mesh")


def read_mesh_file(path: str) -> tuple[TriangleMesh, str]:
    """A closed mesh [m], upright along z, and the SHA-256 of its file; read once for each content.

    Raises:
        FileError: If it cannot be read, is of another format, or holds no closed mesh.
    """
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise FileError(path, f"is not one of {', '.join(_SUFFIXES)}")
    content = read_bytes(path, _LARGEST)
    sha256 = hashlib.sha256(content).hexdigest()
    if (path, sha256) not in _meshes:
        _meshes[path, sha256] = _read(path, content)
    return _meshes[path, sha256], sha256


def _read(path: str, content: bytes) -> TriangleMesh:
    """The mesh in the content of a file."""
    import trimesh

    suffix = Path(path).suffix.lower()
    try:  # of the content alone: a file that it names is not opened
        found: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], force="mesh", process=False)
        if not 0 <= found.faces.min(initial=0) <= found.faces.max(initial=0) < max(len(found.vertices), 1):
            raise FileError(path, f"a face of the mesh names no vertex of the {len(found.vertices)}")
        found.merge_vertices(merge_tex=True, merge_norm=True)
        found.update_faces(found.nondegenerate_faces() & found.unique_faces())
        found.remove_unreferenced_vertices()
    except FileError:
        raise
    except Exception as err:  # whatever a damaged file makes of the reader
        raise FileError(path, f"holds no triangle that can be read: {described(err)}") from err
    vertices, faces = np.array(found.vertices, np.float64), np.array(found.faces, np.int64)
    if not len(faces):
        raise FileError(path, "holds no triangle that can be read")
    if len(faces) > _MOST_FACES:
        raise FileError(path, f"holds {len(faces)} triangles, more than {_MOST_FACES}")
    if suffix == ".glb":  # glTF has y up, all others as they were drawn: z up here
        vertices = vertices @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    mesh = TriangleMesh(vertices, faces)
    try:
        mesh.in_unit_box()
        if mesh.volume() < 0.0:  # it is inside out
            mesh = TriangleMesh(vertices, np.ascontiguousarray(faces[:, ::-1]))
        mesh.in_unit_box().closed("mesh")
    except SimulationError as err:
        raise FileError(path, str(err).removeprefix("mesh: ")) from err
    return mesh
