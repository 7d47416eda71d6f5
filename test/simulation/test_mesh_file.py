# SPDX-License-Identifier: Apache-2.0
"""Objects of a scene whose surface comes from a file, read by Open3D."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from sim_builders import run

from foretouch.errors import ConfigError, FileError, SimulationError
from foretouch.libusb import ensure_libusb
from foretouch.simulation.objects import TriangleMesh, read_mesh_file, unit_mesh
from foretouch.simulation.objects.mesh import rounded_box
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.scene.objects import ObjectConfig

ensure_libusb()
open3d = pytest.importorskip("open3d", reason="Open3D is not installed: pip install foretouch[open3d]")

SIZE = np.array([0.06, 0.05, 0.09])


def write_glb(path: Path, mesh: TriangleMesh) -> str:
    """By hand: Open3D 0.20 writes buffer views that it refuses itself."""
    vertices, faces = mesh.vertices.astype("<f4"), mesh.faces.astype("<u4")
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": vertices.nbytes}]
    views.append({"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": faces.nbytes})
    position = {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"}
    position |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": vertices.nbytes + faces.nbytes}],
        "bufferViews": views,
        "accessors": [position, {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"}],
    }
    chunks = []
    for kind, data in ((b"JSON", json.dumps(document).encode()), (b"BIN\0", vertices.tobytes() + faces.tobytes())):
        padded = data + (b" " if kind == b"JSON" else b"\0") * (-len(data) % 4)
        chunks.append(struct.pack("<I4s", len(padded), kind) + padded)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks))
    return str(path)


def write(path: Path, mesh: TriangleMesh) -> str:
    made = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces)
    )
    made.compute_triangle_normals()
    made.compute_vertex_normals()
    assert open3d.io.write_triangle_mesh(str(path), made)
    return str(path)


@pytest.fixture(scope="module")
def block() -> TriangleMesh:
    return rounded_box(SIZE, 0.01)


@pytest.mark.parametrize("ending", [".obj", ".ply", ".stl", ".glb", ".PLY"])
def test_each_format_gives_the_mesh(tmp_path: Path, block: TriangleMesh, ending: str) -> None:
    drawn = block
    if ending == ".glb":  # y is up
        drawn = TriangleMesh(
            block.vertices @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), block.faces
        )
    written = (write_glb if ending == ".glb" else write)(tmp_path / f"block{ending}", drawn)
    found, sha256 = read_mesh_file(written)
    np.testing.assert_allclose(found.extents, SIZE, atol=1e-6)
    assert found.is_closed()
    assert found.volume() == pytest.approx(block.volume(), rel=1e-4)
    assert len(sha256) == 64


def test_a_mesh_that_is_inside_out_is_turned(tmp_path: Path, block: TriangleMesh) -> None:
    path = write(tmp_path / "block.ply", TriangleMesh(block.vertices, block.faces[:, ::-1]))
    assert read_mesh_file(path)[0].volume() == pytest.approx(block.volume(), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("open.ply", None, "not shared by two faces"),
        ("empty.obj", b"", "holds no triangle"),
        ("damaged.stl", b"solid x\nfacet normal", "holds no triangle"),
        ("damaged.glb", b"glTF\x02\x00\x00\x00", "holds no triangle"),
        ("mesh.dae", b"", "is none of .obj, .ply, .stl, .glb"),
        ("folder.ply", "folder", "is a folder"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(
    tmp_path: Path, block: TriangleMesh, name: str, content: bytes | str | None, reason: str
) -> None:
    path = tmp_path / name
    if content is None:
        write(path, TriangleMesh(block.vertices, block.faces[1:]))
    elif isinstance(content, str):
        path.mkdir()
    else:
        path.write_bytes(content)
    with pytest.raises(FileError, match=reason) as caught:
        read_mesh_file(str(path))
    assert str(path) in str(caught.value)
    with pytest.raises(ConfigError, match=f"thing.file: .*{reason}"):
        ObjectConfig(name="thing", shape="mesh", file=str(path))


def test_a_scene_with_a_mesh_gives_samples_of_its_size(tmp_path: Path, block: TriangleMesh) -> None:
    write(tmp_path / "block.stl", block)
    mapping = {"objects": [{"name": "thing", "shape": "mesh", "file": "block.stl", "size_m": []}], "seed": 3}
    scene = SceneConfig.from_mapping(mapping, str(tmp_path / "scene.yaml"))
    np.testing.assert_allclose(scene.objects[0].size_m, SIZE, atol=1e-6)
    assert SceneConfig.from_mapping(scene.to_mapping()).sha256() == scene.sha256()
    state = run(scene)
    np.testing.assert_allclose(state.bodies[0].size, SIZE, atol=1e-6)
    assert state.touch is not None


def test_the_hash_of_a_scene_covers_the_content_of_the_mesh_and_not_its_path(
    tmp_path: Path, block: TriangleMesh
) -> None:
    def scene(path: str, **more: str) -> SceneConfig:
        item = {"name": "thing", "shape": "mesh", "file": path, "size_m": [0.06, 0.05, 0.09], **more}
        return SceneConfig.from_mapping({"objects": [item]})

    first = scene(write(tmp_path / "a.ply", block))
    assert scene(write(tmp_path / "b.ply", block)).sha256() == first.sha256()
    other = write(tmp_path / "c.ply", rounded_box(SIZE, 0.012))
    assert scene(other).sha256() != first.sha256()
    with pytest.raises(ConfigError, match="its sha256 is not"):
        scene(other, file_sha256=first.objects[0].file_sha256)


def test_a_file_that_was_changed_since_is_refused(tmp_path: Path, block: TriangleMesh) -> None:
    item = ObjectConfig(name="thing", shape="mesh", file=write(tmp_path / "a.ply", block), size_m=())
    write(tmp_path / "a.ply", rounded_box(SIZE, 0.012))
    with pytest.raises(SimulationError, match="has changed since the scene was read"):
        unit_mesh(item.solid)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"shape": "mesh"}, "thing.file: is needed for the shape mesh"),
        ({"shape": "can", "file": "a.ply"}, "thing.file: is only for the shape mesh"),
        ({"shape": "can", "size_m": ()}, "size_m: .* is not three lengths"),
    ],
)
def test_a_file_belongs_to_the_shape_mesh(settings: dict[str, object], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        ObjectConfig(name="thing", **settings)


def test_a_mesh_in_millimetres_is_refused_by_its_size(tmp_path: Path, block: TriangleMesh) -> None:
    path = write(tmp_path / "mm.ply", TriangleMesh(block.vertices * 1e3, block.faces))
    with pytest.raises(ConfigError, match=r"size_m: .* is not three lengths from 0.005 to 0.5 m"):
        ObjectConfig(name="thing", shape="mesh", file=path, size_m=())
