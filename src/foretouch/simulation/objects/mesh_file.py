# SPDX-License-Identifier: Apache-2.0
"""Meshes from files, read by Open3D (extra `open3d`): OBJ, PLY, STL, GLB."""

from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.checked_files import file_sha256
from foretouch.errors import FileError, MissingDependencyError, SimulationError, shown
from foretouch.libusb import ensure_libusb
from foretouch.simulation.objects.mesh import TriangleMesh

_SUFFIXES: Final = (".obj", ".ply", ".stl", ".glb")
_LARGEST: Final = 100_000_000  # bytes
_MOST_FACES: Final = 1_000_000
_UP_Y: Final = (".glb",)  # glTF has y up, all others as they were drawn: z up here


def read_mesh_file(path: str) -> tuple[TriangleMesh, str]:
    """A closed mesh [m], upright along z, and the SHA-256 of its file.

    Raises:
        FileError: If it cannot be read, is of another format, or holds no closed mesh.
        MissingDependencyError: If Open3D is not installed.
    """
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise FileError(path, f"is none of {', '.join(_SUFFIXES)}")
    sha256 = file_sha256(path)
    if Path(path).stat().st_size > _LARGEST:
        raise FileError(path, f"is larger than {_LARGEST // 1_000_000} MB")
    return _read(path, sha256), sha256


@lru_cache(maxsize=64)
def _read(path: str, _sha256: str) -> TriangleMesh:
    """As `read_mesh_file`, once for each content."""
    try:
        ensure_libusb()
        import open3d
    except (ImportError, MissingDependencyError) as err:
        raise MissingDependencyError(f"{shown(path)}: meshes from files need Open3D: pip install open3d") from err
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        found = open3d.io.read_triangle_mesh(Path(path))
        found.remove_duplicated_vertices()
        found.remove_degenerate_triangles()
        found.remove_duplicated_triangles()
        found.remove_unreferenced_vertices()
    vertices, faces = np.asarray(found.vertices, np.float64), np.asarray(found.triangles, np.int64)
    if not len(faces):
        raise FileError(path, "holds no triangle that can be read")
    if len(faces) > _MOST_FACES:
        raise FileError(path, f"holds {len(faces)} triangles, more than {_MOST_FACES}")
    if Path(path).suffix.lower() in _UP_Y:
        vertices = vertices @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    if np.isfinite(vertices).all() and TriangleMesh(vertices, faces).volume() < 0.0:
        faces = faces[:, ::-1]  # it is inside out
    mesh = TriangleMesh(vertices, np.ascontiguousarray(faces))
    try:
        mesh.in_unit_box().closed("mesh")
    except SimulationError as err:
        raise FileError(path, str(err).removeprefix("mesh: ")) from err
    return mesh
