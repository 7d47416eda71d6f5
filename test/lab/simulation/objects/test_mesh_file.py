# SPDX-License-Identifier: Apache-2.0
"""Objects of a scene whose surface comes from a file."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from every_case import every_case, every_refusal
from sim_builders import run

from foretouch.errors import ConfigError, FileError, SimulationError
from foretouch_lab.simulation.objects import TriangleMesh, read_mesh_file, unit_mesh
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig

SIZE = np.array([0.06, 0.05, 0.09])
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def block(size: np.ndarray = SIZE) -> TriangleMesh:
    mesh = unit_mesh("box")
    return TriangleMesh(mesh.vertices * size, mesh.faces)


def write(path: Path, mesh: TriangleMesh) -> str:
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    return str(path)


def test_each_format_gives_the_mesh_with_its_outside_outside(tmp_path: Path) -> None:
    def check(ending: str, flip: int) -> None:
        drawn = TriangleMesh(block().vertices @ (Y_UP if ending == ".glb" else np.eye(3)), block().faces[:, ::flip])
        found, sha256 = read_mesh_file(write(tmp_path / f"block{ending}", drawn))
        np.testing.assert_allclose(found.extents, SIZE, atol=1e-6)
        read = trimesh.Trimesh(found.vertices, found.faces, process=False)
        assert read.volume == pytest.approx(0.99 * SIZE.prod(), rel=0.02)
        assert len(sha256) == 64

    every_case([(ending, 1) for ending in (".obj", ".ply", ".stl", ".glb")] + [(".ply", -1)], check)


def test_a_file_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    write(tmp_path / "open.ply", TriangleMesh(block().vertices, block().faces[1:]))
    write(tmp_path / "flat.ply", TriangleMesh(block().vertices * [1.0, 1.0, 0.0], block().faces))
    write(
        tmp_path / "far.ply", TriangleMesh(np.where(block().vertices > 0.02, np.inf, block().vertices), block().faces)
    )
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

    cases = {"open.ply": "not shared by two faces", "flat.ply": "is flat", "far.ply": "not finite"}
    cases |= dict.fromkeys(("empty.obj", "damaged.stl", "damaged.glb"), "holds no triangle")
    cases |= {f"index{number}.ply": "names no vertex of the 4|no triangle" for number in range(len(wrong))}
    cases |= {"mesh.dae": "is not one of .obj, .ply, .stl, .glb", "folder.ply": "is a folder", "fifo.stl": "is a FIFO"}
    every_case([*cases.items(), ("library.obj", "mesh|triangle")], check)


def test_a_scene_has_the_size_and_the_hash_of_its_mesh_wherever_that_lies(tmp_path: Path) -> None:
    write(tmp_path / "block.stl", block())
    mapping = {"objects": [{"name": "thing", "shape": "mesh", "file": "block.stl", "size_m": []}], "seed": 3}
    beside = SceneConfig.from_mapping(mapping, str(tmp_path / "scene.yaml"))
    np.testing.assert_allclose(beside.objects[0].size_m, SIZE, atol=1e-6)
    assert SceneConfig.from_mapping(beside.to_mapping()).sha256() == beside.sha256()
    np.testing.assert_allclose(run(beside).bodies[0].size, SIZE, atol=1e-6)

    def scene(path: str, **more: str) -> SceneConfig:
        item = {"name": "thing", "shape": "mesh", "file": path, "size_m": [0.06, 0.05, 0.09], **more}
        return SceneConfig.from_mapping({"objects": [item]})

    first = scene(write(tmp_path / "a.ply", block()))
    assert scene(write(tmp_path / "b.ply", block())).sha256() == first.sha256()
    other = write(tmp_path / "c.ply", block(SIZE * 1.1))
    assert scene(other).sha256() != first.sha256()
    with pytest.raises(ConfigError, match="its sha256 is not"):
        scene(other, file_sha256=first.objects[0].file_sha256)
    write(tmp_path / "a.ply", block(SIZE * 1.1))
    with pytest.raises(SimulationError, match="has changed since the scene was read"):
        unit_mesh(first.objects[0].solid)
    millimetres = write(tmp_path / "mm.ply", block(SIZE * 1e3))
    cases = [
        ("thing.file: is needed for the shape mesh", {"shape": "mesh"}),
        ("thing.file: is only for the shape mesh", {"shape": "can", "file": "a.ply"}),
        (r"thing\.file: .*mm\.ply: size_m: .* to 0.5 m", {"shape": "mesh", "file": millimetres, "size_m": ()}),
    ]
    every_refusal(ConfigError, cases, lambda settings: ObjectConfig(name="thing", **settings))
