# SPDX-License-Identifier: Apache-2.0
"""Reading back what was written, what Open3D wrote, and naming what is broken."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.errors import FileError
from foretouch.libusb import ensure_libusb
from foretouch.types import Cloud


def _cloud(rng: np.random.Generator, shape: tuple[int, ...], *, with_rgb: bool) -> Cloud:
    xyz = rng.normal(size=(*shape, 3)).astype(np.float32)
    xyz.reshape(-1, 3)[::5] = np.nan
    rgb = rng.integers(0, 256, xyz.shape, dtype=np.uint8) if with_rgb else None
    return Cloud(xyz, rgb, "camera", 1_234_567_890_123_456_789)


def _assert_same(read: Cloud, written: Cloud, *, with_rgb: bool = True) -> None:
    np.testing.assert_array_equal(read.xyz, written.xyz)
    if with_rgb and written.rgb is not None:
        assert read.rgb is not None
        np.testing.assert_array_equal(read.rgb, written.rgb)
    else:
        assert read.rgb is None


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz", ".npy", ".PCD", ".NPZ"])
@pytest.mark.parametrize("shape", [(37,), (6, 7), (1,)])
@pytest.mark.parametrize("with_rgb", [False, True])
def test_what_is_written_is_read_back(
    tmp_path: Path, rng: np.random.Generator, suffix: str, shape: tuple[int, ...], with_rgb: bool
) -> None:
    cloud = _cloud(rng, shape, with_rgb=with_rgb)
    write_cloud(tmp_path / f"a{suffix}", cloud)
    _assert_same(read_cloud(tmp_path / f"a{suffix}"), cloud, with_rgb=suffix != ".npy")


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz", ".npy"])
def test_an_empty_cloud_is_read_back_empty(tmp_path: Path, suffix: str) -> None:
    write_cloud(tmp_path / f"a{suffix}", Cloud(np.empty((0, 3), np.float32)))
    assert read_cloud(tmp_path / f"a{suffix}").xyz.shape == (0, 3)


def test_npz_keeps_frame_and_stamp(tmp_path: Path, rng: np.random.Generator) -> None:
    cloud = _cloud(rng, (4,), with_rgb=False)
    write_cloud(tmp_path / "a.npz", cloud)
    read = read_cloud(tmp_path / "a.npz")
    assert (read.frame_id, read.stamp_ns) == (cloud.frame_id, cloud.stamp_ns)


@pytest.fixture
def open3d_cloud(rng: np.random.Generator):
    ensure_libusb()
    import open3d

    cloud = open3d.geometry.PointCloud()
    cloud.points = open3d.utility.Vector3dVector(rng.normal(size=(50, 3)).astype(np.float32))
    cloud.colors = open3d.utility.Vector3dVector(rng.integers(0, 256, (50, 3)) / 255.0)
    return open3d, cloud


@pytest.mark.parametrize(
    ("name", "ascii_", "compressed"),
    [
        ("a.pcd", True, False),
        ("a.pcd", False, False),
        ("a.pcd", False, True),
        ("a.ply", True, False),
        ("a.ply", False, False),
    ],
)
def test_open3d_files_are_read(tmp_path: Path, open3d_cloud, name: str, ascii_: bool, compressed: bool) -> None:
    open3d, cloud = open3d_cloud
    open3d.io.write_point_cloud(str(tmp_path / name), cloud, write_ascii=ascii_, compressed=compressed)
    read = read_cloud(tmp_path / name)
    # Open3D writes six digits into an ASCII PLY.
    np.testing.assert_allclose(read.xyz, np.asarray(cloud.points), atol=1e-5)
    np.testing.assert_array_equal(read.rgb, np.rint(np.asarray(cloud.colors) * 255))


@pytest.mark.parametrize("suffix", [".pcd", ".ply"])
def test_open3d_reads_ours(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    ensure_libusb()
    import open3d

    cloud = _cloud(rng, (6, 7), with_rgb=True)
    write_cloud(tmp_path / f"a{suffix}", cloud)
    read = open3d.io.read_point_cloud(str(tmp_path / f"a{suffix}"))
    np.testing.assert_array_equal(np.asarray(read.points).astype(np.float32), cloud.xyz.reshape(-1, 3))
    np.testing.assert_array_equal(np.rint(np.asarray(read.colors) * 255), cloud.rgb.reshape(-1, 3))


def test_pcd_with_padding_doubles_and_extra_fields(tmp_path: Path) -> None:
    points = np.zeros(6, [("i", "<u2"), ("z", "<f8"), ("pad", "u1", 3), ("x", "<f4"), ("y", "<f8"), ("rgba", "<u4")])
    points["x"], points["y"], points["z"] = np.arange(6), 10, np.linspace(0, 1, 6)
    points["rgba"] = 0xFF010203
    header = (
        "VERSION 0.7\nFIELDS intensity z _ x y rgba\nSIZE 2 8 1 4 8 4\nTYPE U F U F F U\nCOUNT 1 1 3 1 1 1\n"
        "WIDTH 3\nHEIGHT 2\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 6\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + points.tobytes())
    cloud = read_cloud(tmp_path / "a.pcd")
    expected = np.stack([points[n].astype(np.float32) for n in "xyz"], -1).reshape(2, 3, 3)
    np.testing.assert_array_equal(cloud.xyz, expected)
    np.testing.assert_array_equal(cloud.rgb, np.broadcast_to(np.array([1, 2, 3], np.uint8), (2, 3, 3)))


def test_ascii_pcd_by_hand(tmp_path: Path) -> None:
    packed = np.array([0x00102030], np.uint32).view(np.float32)[0]
    (tmp_path / "a.pcd").write_text(
        "# a comment\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
        f"1 2 3 {packed!r}\nnan nan nan 0\n".replace("np.float32(", "").replace(")", "")
    )
    cloud = read_cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(cloud.xyz, [[1, 2, 3], [np.nan] * 3])
    np.testing.assert_array_equal(cloud.rgb, [[0x10, 0x20, 0x30], [0, 0, 0]])


_HEADER = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary\n"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("POINTS 2", "POINTS 3"), "POINTS: 3 is not WIDTH 2 x HEIGHT 1"),
        (("WIDTH 2\n", ""), "WIDTH: is missing"),
        (("WIDTH 2", "WIDTH two"), "WIDTH: 'two' is not a whole number"),
        (("FIELDS x y z", "FIELDS x y w"), "FIELDS: z is missing; there are: x y w"),
        (("FIELDS x y z", "FIELDS x y x"), "FIELDS: x y x: a name occurs twice"),
        (("SIZE 4 4 4", "SIZE 4 4"), "SIZE: 2 entries for 3 FIELDS"),
        (("SIZE 4 4 4", "SIZE 4 4 3"), "z: TYPE F of SIZE 3 is no number"),
        (("TYPE F F F", "TYPE F F U"), "z: is not one floating number"),
        (("COUNT 1 1 1", "COUNT 1 1 0"), "z: COUNT 0 is not a positive number"),
        (("DATA binary", "DATA zip"), "DATA: zip is none of"),
        (("DATA binary\n", ""), "header: no line DATA"),
    ],
)
def test_a_broken_pcd_header_is_named(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    (tmp_path / "a.pcd").write_bytes(_HEADER.replace(*change).encode() + bytes(24))
    with pytest.raises(FileError, match=message):
        read_cloud(tmp_path / "a.pcd")


@pytest.mark.parametrize("size", [0, 12, 23])
def test_a_binary_pcd_cut_off_is_refused(tmp_path: Path, size: int) -> None:
    (tmp_path / "a.pcd").write_bytes(_HEADER.encode() + bytes(size))
    with pytest.raises(FileError, match=f"DATA: {size} bytes are fewer than 2 points of 12 = 24"):
        read_cloud(tmp_path / "a.pcd")


@pytest.mark.parametrize(("text", "message"), [("1 2 3\n4 5", "5 numbers are not 2 points"), ("1 2 3 4 5 x", "number")])
def test_broken_ascii_data_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.pcd").write_text(_HEADER.replace("binary", "ascii") + text)
    with pytest.raises(FileError, match=message):
        read_cloud(tmp_path / "a.pcd")


@pytest.mark.parametrize(
    ("name", "ascii_", "compressed"), [("a.pcd", False, True), ("a.ply", True, False), ("a.ply", False, False)]
)
@pytest.mark.parametrize("cut", [1, 9, 200])
def test_a_file_cut_off_is_refused(
    tmp_path: Path, open3d_cloud, name: str, ascii_: bool, compressed: bool, cut: int
) -> None:
    open3d, cloud = open3d_cloud
    path = tmp_path / name
    open3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)
    # The end of an ASCII file is a newline and digits: a digit less is another number, not a broken file.
    path.write_bytes(path.read_bytes()[: -cut - 30 * ascii_])
    with pytest.raises(FileError, match=r"a\.p"):
        read_cloud(path)


def test_a_ply_without_vertices_or_axes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text("ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(FileError, match="element vertex is missing"):
        read_cloud(path)
    path.write_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n")
    with pytest.raises(FileError, match="z: is no property"):
        read_cloud(path)
    path.write_text("not ply")
    with pytest.raises(FileError, match="does not start with ply"):
        read_cloud(path)


def test_numpy_files_of_other_content_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.zeros((3, 3)))
    with pytest.raises(FileError, match="xyz: is missing; there are: points"):
        read_cloud(tmp_path / "a.npz")
    np.save(tmp_path / "b.npy", np.zeros((3, 4)))
    with pytest.raises(FileError, match=r"xyz: shape \(3, 4\)"):
        read_cloud(tmp_path / "b.npy")
    np.save(tmp_path / "c.npy", np.zeros((3, 3), np.int64))
    with pytest.raises(FileError, match="xyz: dtype int64"):
        read_cloud(tmp_path / "c.npy")
    np.savez(tmp_path / "d.npz", xyz=np.zeros((3, 3), np.float32), rgb=np.zeros((2, 3), np.uint8))
    with pytest.raises(FileError, match="rgb: shape"):
        read_cloud(tmp_path / "d.npz")
    np.savez(tmp_path / "e.npz", xyz=np.zeros((3, 3)), stamp_ns=np.zeros(2))
    with pytest.raises(FileError, match="stamp_ns: is not one whole number"):
        read_cloud(tmp_path / "e.npz")


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileError, match=r"a\.npy: is damaged or contains objects"):
        read_cloud(tmp_path / "a.npy")
    np.savez(tmp_path / "b.npz", xyz=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileError, match=r"b\.npz: xyz: is damaged or contains objects"):
        read_cloud(tmp_path / "b.npz")


@pytest.mark.parametrize("suffix", [".npz", ".npy"])
def test_a_numpy_file_cut_off_is_refused(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_cloud(path, _cloud(rng, (50,), with_rgb=False))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(FileError, match=f"a{suffix}"):
        read_cloud(path)


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_of_either_byte_order_with_faces_behind(tmp_path: Path, order: str) -> None:
    kinds = [("y", "f8"), ("x", "f4"), ("flag", "i2"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    vertices = np.zeros(3, [(name, order + kind) for name, kind in kinds])
    for i, (name, _) in enumerate(kinds):
        vertices[name] = np.arange(3) + 10 * i
    words = {"f8": "double", "f4": "float32", "i2": "short", "u1": "uint8"}
    lines = ["ply", f"format binary_{'little' if order == '<' else 'big'}_endian 1.0", "comment x", "element vertex 3"]
    lines += [f"property {words[kind]} {name}" for name, kind in kinds]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header", ""]
    (tmp_path / "a.ply").write_bytes("\n".join(lines).encode() + vertices.tobytes() + bytes([3] + 12 * [0]))
    cloud = read_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(cloud.xyz, [[10, 0, 30], [11, 1, 31], [12, 2, 32]])
    np.testing.assert_array_equal(cloud.rgb, [[40, 50, 60], [41, 51, 61], [42, 52, 62]])


def test_unknown_endings_and_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"a\.xyz: the extension is none of \.pcd, \.ply, \.npz, \.npy"):
        read_cloud(tmp_path / "a.xyz")
    with pytest.raises(FileError, match="the extension is none of"):
        write_cloud(tmp_path / "a", Cloud(np.zeros((1, 3), np.float32)))
    for suffix in (".pcd", ".ply", ".npz", ".npy"):
        with pytest.raises(FileError, match="No such file"):
            read_cloud(tmp_path / f"none{suffix}")
        with pytest.raises(FileError, match="No such file"):
            write_cloud(tmp_path / "none" / f"a{suffix}", Cloud(np.zeros((1, 3), np.float32)))


@pytest.mark.real_data
def test_real_clouds_agree_with_open3d(real_data: Path) -> None:
    ensure_libusb()
    import open3d

    paths = sorted(real_data.glob("vision2tactile/*/*/cloud-object.pcd"))
    assert len(paths) >= 400
    for path in paths[::20]:
        cloud = read_cloud(path)
        theirs = open3d.io.read_point_cloud(str(path))
        np.testing.assert_array_equal(cloud.xyz, np.asarray(theirs.points).astype(np.float32))
        np.testing.assert_array_equal(cloud.rgb, np.rint(np.asarray(theirs.colors) * 255))


def test_damaged_bytes_never_escape_as_another_error(tmp_path: Path, rng: np.random.Generator) -> None:
    buffer = io.BytesIO()
    write_cloud(tmp_path / "a.pcd", _cloud(rng, (20,), with_rgb=True))
    buffer.write((tmp_path / "a.pcd").read_bytes())
    original = bytearray(buffer.getvalue())
    for _ in range(300):
        damaged = bytearray(original)
        damaged[int(rng.integers(200))] = int(rng.integers(256))
        (tmp_path / "b.pcd").write_bytes(damaged)
        try:
            read_cloud(tmp_path / "b.pcd")
        except FileError as err:
            assert "\n" not in str(err)  # noqa: PT017
