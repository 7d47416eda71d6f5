# SPDX-License-Identifier: Apache-2.0
"""Closed triangle meshes for ray casting, and their reading from files by trimesh: OBJ, PLY, STL, GLB."""

import hashlib
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import read_bytes
from foretouch.errors import FileError, described
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

    @cached_property
    def centroid(self) -> Float64:
        """(3,) float64, centre of the enclosed volume, by the divergence theorem."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        six_volumes = np.einsum("ij,ij->i", a, np.cross(b, c))
        return np.asarray(six_volumes @ (a + b + c) / (4.0 * six_volumes.sum()), np.float64)

    def in_unit_box(self) -> "TriangleMesh":
        """Move and scale the mesh, each axis by itself, to [-0.5, 0.5]³."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return TriangleMesh((self.vertices - (low + high) / 2.0) / (high - low), self.faces)


def read_mesh_file(path: str) -> tuple[TriangleMesh, str]:
    """Return a closed mesh [m], upright along z, and the SHA-256 of its file; read once for each content.

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
    """Return the mesh in the content of a file."""
    import trimesh

    suffix = Path(path).suffix.lower()
    try:  # of the content alone: a file that it names is not opened
        mesh: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], force="mesh", process=False)
        usable = np.isfinite(mesh.vertices).all() and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
        if usable and len(mesh.faces) <= _MOST_FACES:
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
            mesh.remove_unreferenced_vertices()
            closed = mesh.is_watertight and mesh.is_winding_consistent and mesh.extents.min() > 0.0
    except Exception as err:  # whatever a damaged file makes of the reader
        raise FileError(path, f"holds no triangle that can be read: {described(err)}") from err
    if not usable:
        raise FileError(path, f"a face of the mesh names no vertex of the {len(mesh.vertices)}, or one is not finite")
    if len(mesh.faces) > _MOST_FACES:
        raise FileError(path, f"holds {len(mesh.faces)} triangles, more than {_MOST_FACES}")
    if not closed:
        raise FileError(path, "the mesh is flat, or has an edge that is not shared by two faces")
    vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
    if mesh.volume < 0.0:  # it is inside out
        faces = np.ascontiguousarray(faces[:, ::-1])
    if suffix == ".glb":  # glTF has y up, all others as they were drawn: z up here
        vertices = vertices @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return TriangleMesh(vertices, faces)
