# SPDX-License-Identifier: Apache-2.0
"""Objects of a scene whose surface comes from a file that Open3D wrote."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case, every_refusal
from sim_builders import run

from foretouch.camera.device import ensure_libusb
from foretouch.errors import ConfigError, FileError, SimulationError
from foretouch_lab.simulation.objects import TriangleMesh, read_mesh_file, unit_mesh
from foretouch_lab.simulation.objects.shapes import _rounded_box
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig

ensure_libusb()
open3d = pytest.importorskip("open3d", reason="Open3D is not installed: pip install foretouch[open3d]")

SIZE = np.array([0.06, 0.05, 0.09])


def write_glb(path: Path, mesh: TriangleMesh) -> str:
    """By hand, corner by corner: Open3D 0.20 writes buffer views that it refuses itself."""
    corners = mesh.vertices[mesh.faces.ravel()].astype("<f4")
    box = {"min": corners.min(axis=0).tolist(), "max": corners.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": corners.nbytes}],
        "bufferViews": [{"buffer": 0, "byteLength": corners.nbytes}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(corners), "type": "VEC3", **box}],
    }
    head = json.dumps(document).encode()
    chunks = ((b"JSON", head + b" " * (-len(head) % 4)), (b"BIN\0", corners.tobytes()))
    data = b"".join(struct.pack("<I4s", len(chunk), kind) + chunk for kind, chunk in chunks)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(data)) + data)
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
    return _rounded_box(SIZE, 0.01)


def test_each_format_gives_the_mesh(tmp_path: Path, block: TriangleMesh) -> None:
    y_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

    def check(ending: str) -> None:
        glb = ending == ".glb"
        drawn = TriangleMesh(block.vertices @ y_up, block.faces) if glb else block
        found, sha256 = read_mesh_file((write_glb if glb else write)(tmp_path / f"block{ending}", drawn))
        np.testing.assert_allclose(found.extents, SIZE, atol=1e-6)
        assert found.closed("mesh").volume() == pytest.approx(block.volume(), rel=1e-4)
        assert len(sha256) == 64

    every_case([".obj", ".ply", ".stl", ".glb", ".PLY"], check)
    inside_out = write(tmp_path / "turned.ply", TriangleMesh(block.vertices, block.faces[:, ::-1]))
    assert read_mesh_file(inside_out)[0].volume() == pytest.approx(block.volume(), rel=1e-6)


def test_a_file_that_cannot_be_used_is_named(tmp_path: Path, block: TriangleMesh) -> None:
    (tmp_path / "folder.ply").mkdir()
    write(tmp_path / "open.ply", TriangleMesh(block.vertices, block.faces[1:]))
    (tmp_path / "empty.obj").write_bytes(b"")
    (tmp_path / "damaged.stl").write_bytes(b"solid x\nfacet normal")
    (tmp_path / "damaged.glb").write_bytes(b"glTF\x02\x00\x00\x00")
    (tmp_path / "mesh.dae").write_bytes(b"")

    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\nelement face 4\n"
    corners, wrong = "end_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n", ((3, 2_000_000_000), (-1, -2), (4, 0))
    for number, (first, second) in enumerate(wrong):
        faces = f"3 0 1 {first}\n3 0 {second} 2\n3 0 2 3\n3 1 2 3\n"
        (tmp_path / f"index{number}.ply").write_text(f"{head}property list uchar int vertex_indices\n{corners}{faces}")
    os.mkfifo(tmp_path / "materials")
    (tmp_path / "library.obj").write_text("mtllib materials\nv 0 0 0\nf 1 1 1\n")
    os.mkfifo(tmp_path / "fifo.stl")

    def check(name: str, reason: str) -> None:
        path = str(tmp_path / name)
        with pytest.raises(FileError, match=reason) as caught:
            read_mesh_file(path)
        assert path in str(caught.value)
        with pytest.raises(ConfigError, match=f"thing.file: .*{reason}"):
            ObjectConfig(name="thing", shape="mesh", file=path)

    cases = {"open.ply": "not shared by two faces", "mesh.dae": "is not one of .obj, .ply, .stl, .glb"}
    cases |= dict.fromkeys(("empty.obj", "damaged.stl", "damaged.glb"), "holds no triangle")
    cases |= {f"index{number}.ply": "names no vertex of the 4|no triangle" for number in range(len(wrong))}
    every_case(
        [*cases.items(), ("folder.ply", "is a folder"), ("fifo.stl", "is a FIFO"), ("library.obj", "mesh|triangle")],
        check,
    )


def test_a_mesh_is_read_without_a_warning(tmp_path: Path, block: TriangleMesh) -> None:
    code = f"from foretouch_lab.simulation.objects import read_mesh_file as r; print(len(r({write(tmp_path / 'a.stl', block)!r})))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("2\n", "")


def test_a_scene_with_a_mesh_gives_samples_of_its_size(tmp_path: Path, block: TriangleMesh) -> None:
    write(tmp_path / "block.stl", block)
    mapping = {"objects": [{"name": "thing", "shape": "mesh", "file": "block.stl", "size_m": []}], "seed": 3}
    scene = SceneConfig.from_mapping(mapping, str(tmp_path / "scene.yaml"))
    np.testing.assert_allclose(scene.objects[0].size_m, SIZE, atol=1e-6)
    assert SceneConfig.from_mapping(scene.to_mapping()).sha256() == scene.sha256()
    state = run(scene)
    np.testing.assert_allclose(state.bodies[0].size, SIZE, atol=1e-6)
    assert state.touch is not None


def test_the_hash_of_a_scene_covers_the_mesh_and_not_its_path(tmp_path: Path, block: TriangleMesh) -> None:
    def scene(path: str, **more: str) -> SceneConfig:
        item = {"name": "thing", "shape": "mesh", "file": path, "size_m": [0.06, 0.05, 0.09], **more}
        return SceneConfig.from_mapping({"objects": [item]})

    first = scene(write(tmp_path / "a.ply", block))
    assert scene(write(tmp_path / "b.ply", block)).sha256() == first.sha256()
    other = write(tmp_path / "c.ply", _rounded_box(SIZE, 0.012))
    assert scene(other).sha256() != first.sha256()
    with pytest.raises(ConfigError, match="its sha256 is not"):
        scene(other, file_sha256=first.objects[0].file_sha256)
    write(tmp_path / "a.ply", _rounded_box(SIZE, 0.012))
    with pytest.raises(SimulationError, match="has changed since the scene was read"):
        unit_mesh(first.objects[0].solid)


def test_settings_that_do_not_fit_the_shape_are_refused(tmp_path: Path, block: TriangleMesh) -> None:
    millimetres = write(tmp_path / "mm.ply", TriangleMesh(block.vertices * 1e3, block.faces))
    cases = [
        ("thing.file: is needed for the shape mesh", {"shape": "mesh"}),
        ("thing.file: is only for the shape mesh", {"shape": "can", "file": "a.ply"}),
        ("size_m: .* is not three lengths", {"shape": "can", "size_m": ()}),
        (
            r"thing\.file: .*mm\.ply: size_m: .* from 0.005 to 0.5 m; it looks like millimetres: give size_m in metres",
            {"shape": "mesh", "file": millimetres, "size_m": ()},
        ),
    ]
    every_refusal(ConfigError, cases, lambda settings: ObjectConfig(name="thing", **settings))
