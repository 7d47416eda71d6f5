# SPDX-License-Identifier: Apache-2.0
"""Reading back what was written, what Open3D wrote, and naming what is broken."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case, every_refusal

from foretouch.camera.device import ensure_libusb
from foretouch.cloud.io.files import CLOUD_SUFFIXES, read_cloud, write_cloud
from foretouch.errors import FileError
from foretouch.types import Cloud


def _cloud(rng: np.random.Generator, shape: tuple[int, ...], *, with_rgb: bool) -> Cloud:
    xyz = rng.normal(size=(*shape, 3)).astype(np.float32)
    xyz.reshape(-1, 3)[::5] = np.nan
    rgb = rng.integers(0, 256, xyz.shape, dtype=np.uint8) if with_rgb else None
    return Cloud(xyz, rgb, "camera", 1_234_567_890_123_456_789)


def _assert_refused(path: Path, content: str | bytes, message: str) -> None:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FileError, match=message):
        read_cloud(path)


def test_what_is_written_is_read_back(tmp_path: Path, rng: np.random.Generator) -> None:
    def check(suffix: str, shape: tuple[int, ...], with_rgb: bool) -> None:
        cloud = _cloud(rng, shape, with_rgb=with_rgb)
        write_cloud(tmp_path / f"a{suffix}", cloud)
        read = read_cloud(tmp_path / f"a{suffix}")
        np.testing.assert_array_equal(read.xyz, cloud.xyz)
        np.testing.assert_array_equal(read.rgb, None if suffix == ".npy" else cloud.rgb)
        if suffix == ".npz":
            assert (read.frame_id, read.stamp_ns) == (cloud.frame_id, cloud.stamp_ns)

    every_case(product([*CLOUD_SUFFIXES, ".PCD", ".NPZ"], [(37,), (6, 7), (1,), (0,)], [False, True]), check)


@pytest.fixture
def open3d():
    ensure_libusb()
    import open3d

    return open3d


def test_files_are_exchanged_with_open3d_and_refused_where_cut_off(tmp_path: Path, open3d, rng) -> None:
    cloud = open3d.geometry.PointCloud()
    cloud.points = open3d.utility.Vector3dVector(rng.normal(size=(50, 3)).astype(np.float32))
    cloud.colors = open3d.utility.Vector3dVector(rng.integers(0, 256, (50, 3)) / 255.0)

    def check(name: str, ascii_: bool, compressed: bool) -> None:
        path = tmp_path / name
        open3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)
        read, content = read_cloud(path), path.read_bytes()
        # Open3D writes six digits into an ASCII PLY.
        np.testing.assert_allclose(read.xyz, np.asarray(cloud.points), atol=1e-5)
        np.testing.assert_array_equal(read.rgb, np.rint(np.asarray(cloud.colors) * 255))
        for cut in (1, 9, 200):
            # The end of an ASCII file is a newline and digits: a digit less is another number, not a broken file.
            _assert_refused(path, content[: -cut - 30 * ascii_], r"a\.p")

    cases = [("a.pcd", True, False), ("a.pcd", False, False), ("a.pcd", False, True), ("a.ply", True, False)]
    every_case([*cases, ("a.ply", False, False)], check)
    for suffix in (".pcd", ".ply"):  # and ours by Open3D
        ours = _cloud(rng, (6, 7), with_rgb=True)
        write_cloud(tmp_path / f"b{suffix}", ours)
        read = open3d.io.read_point_cloud(str(tmp_path / f"b{suffix}"))
        np.testing.assert_array_equal(np.asarray(read.points).astype(np.float32), ours.xyz.reshape(-1, 3))
        np.testing.assert_array_equal(np.rint(np.asarray(read.colors) * 255), ours.rgb.reshape(-1, 3))


def test_pcd_with_padding_doubles_and_extra_fields(tmp_path: Path) -> None:
    kinds = [("intensity", "<u2"), ("z", "<f8"), ("_", "u1", 3), ("x", "<f4"), ("y", "<f8"), ("rgba", "<u4")]
    points = np.zeros(6, kinds)
    points["x"], points["y"], points["z"] = np.arange(6), 10, np.linspace(0, 1, 6)
    points["rgba"] = 0xFF010203
    header = (
        "VERSION 0.7\nFIELDS intensity z _ x y rgba\nSIZE 2 8 1 4 8 4\nTYPE U F U F F U\nCOUNT 1 1 3 1 1 1\n"
        "WIDTH 3\nHEIGHT 2\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 6\nDATA "
    )
    # LZF with literal runs of at most 32 bytes: as any packer may write it.
    columns = b"".join(points[name].tobytes() for name in points.dtype.names)
    runs = [columns[k : k + 32] for k in range(0, len(columns), 32)]
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    sizes = np.array([len(packed), len(columns)], "<u4").tobytes()
    rows = "".join(" ".join(map(str, [p[0], p[1], *p[2], *p.tolist()[3:]])) + "\n" for p in points)
    every = {"binary": points.tobytes(), "binary_compressed": sizes + packed, "ascii": rows.encode()}

    def check(data: str) -> None:
        (tmp_path / "a.pcd").write_bytes((header + data + "\n").encode() + every[data])
        cloud = read_cloud(tmp_path / "a.pcd")
        expected = np.stack([points[n].astype(np.float32) for n in "xyz"], -1).reshape(2, 3, 3)
        np.testing.assert_array_equal(cloud.xyz, expected)
        np.testing.assert_array_equal(cloud.rgb, np.broadcast_to(np.array([1, 2, 3], np.uint8), (2, 3, 3)))

    every_case(list(every), check)
    packed = float(np.array([0x00102030], np.uint32).view(np.float32)[0])
    header = "# a comment\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(f"{header}1 2\t3  {packed!r}\nnan nan nan 0\n")
    cloud = read_cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(cloud.xyz, [[1, 2, 3], [np.nan] * 3])
    np.testing.assert_array_equal(cloud.rgb, [[0x10, 0x20, 0x30], [0, 0, 0]])


def test_a_broken_pcd_is_named(tmp_path: Path) -> None:
    header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary\n"
    cases = [
        ("POINTS 2", "POINTS 3", "POINTS: 3 is not WIDTH 2 x HEIGHT 1"),
        ("WIDTH 2\n", "", "WIDTH: is missing"),
        ("FIELDS x y z", "FIELDS x y w", "FIELDS: z is missing; there are: x y w"),
        ("FIELDS x y z", "FIELDS x y x", "FIELDS: .* not a list of numbers: field .x. occurs more than once"),
        ("SIZE 4 4 4", "SIZE 4 4 3", "z: TYPE F of SIZE 3 is not a number"),
        ("TYPE F F F", "TYPE F F U", "z: is not one floating number"),
        ("COUNT 1 1 1", "COUNT 1 1 0", "z: is not one floating number"),
        ("DATA binary", "DATA zip", "DATA: zip is not one of"),
        ("DATA binary\n", "DATA ascii\n1 2 3\n4 5", "DATA: not a table of numbers"),
    ]
    every_case(
        {f"{old} {new}": (old, new, rule) for old, new, rule in cases},
        lambda old, new, rule: _assert_refused(tmp_path / "a.pcd", header.replace(old, new).encode() + bytes(24), rule),
    )
    text = header.replace("binary", "ascii")
    _assert_refused(tmp_path / "a.pcd", text + "1 2 3 4 5 x", "DATA: not a table of numbers")
    coloured = text.replace("FIELDS", "FIELDS rgb").replace("SIZE 4", "SIZE 2 4").replace("TYPE", "TYPE U")
    coloured = coloured.replace("COUNT", "COUNT 1")
    _assert_refused(tmp_path / "a.pcd", coloured, "rgb: is not one number of 4 bytes")
    _assert_refused(
        tmp_path / "a.pcd", header.encode() + bytes(23), "DATA: 23 bytes are fewer than 2 points of 12 = 24"
    )
    compressed = header.replace("binary", "binary_compressed").encode()
    for body, rule in (
        (b"1234567", "unpack to"),
        (np.array([4, 23], "<u4").tobytes() + b"1234", "unpack to 23 bytes, not to 2 points = 24"),
        (np.array([4, 24], "<u4").tobytes() + b"1234", "is not LZF data"),
    ):
        _assert_refused(tmp_path / "a.pcd", compressed + body, f"DATA: .*{rule}")


def test_a_broken_ply_is_named(tmp_path: Path) -> None:
    vertices = "element vertex 1\nproperty float x\nproperty float y\n"
    z, grid = "property float z\n", "element range_grid 1\nproperty list uchar int a\n"
    cases = [
        ("ply\nformat ascii 1.0\nend_heade", "header: no line end_header: truncated"),
        ("ply\nformat ascii 1.0\nend_header\n", "header: element vertex is missing"),
        (
            f"ply\nformat ascii 1.0\n{vertices}{z}{z}end_header\n1 2\n",
            "property: is not a list of numbers: field .z. occurs more than once",
        ),
        (
            f"ply\nformat ascii 1.0\n{vertices}property list uchar number a\nend_header\n",
            "list uchar number a: is neither a number nor a list",
        ),
        (
            f"ply\nformat ascii 1.0\n{vertices}{z}property list int int a\nend_header\n1 2 3 -1\n",
            "a: a list of -1.0 entries",
        ),
        (
            f"ply\nformat ascii 1.0\n{vertices}{z}property list int int a\nend_header\n1 2 3 2 7\n",
            "element vertex: the data ends within its 1",
        ),
        (
            f"ply\nformat ascii 1.0\nobj_info num_cols 1\n{vertices}{z}{grid}end_header\n1 2 3 1 1\n",
            "range_grid: there is no vertex 1, only 1",
        ),
        (f"ply\nformat ascii 1.0\n{vertices}{z}end_header\n1 2\n", "vertex: 4 bytes are fewer than 3 numbers"),
        (f"ply\nformat ascii 1.0\n{vertices}{z}end_header\n1 22222\n", "vertex: 2 numbers are fewer than 3: truncated"),
        (f"ply\nformat ascii 1.0\n{vertices}{z}end_header\n1 2 three\n", "vertex: holds a word between its numbers"),
        (f"ply\nformat ascii 1.0\n{vertices}{z}element vertex 1\nend_header\n1 2 3\n", "element: vertex occurs twice"),
    ]
    every_case(cases, lambda text, rule: _assert_refused(tmp_path / "a.ply", text, rule))


def test_numpy_files_of_other_content_unknown_endings_and_missing_files_are_refused(tmp_path: Path) -> None:
    points, objects = np.zeros((3, 3), np.float32), np.array([{"a": 1}], dtype=object)
    cases = {
        "xyz: is missing; there are: points": {"points": points},
        r"xyz: shape \(3, 4\)": {"xyz": np.zeros((3, 4))},
        "xyz: dtype int64": {"xyz": np.zeros((3, 3), np.int64)},
        "rgb: shape": {"xyz": points, "rgb": np.zeros((2, 3), np.uint8)},
        "stamp_ns: is not one whole number": {"xyz": points, "stamp_ns": np.zeros(2)},
        "frame_id: is not one text": {"xyz": points, "frame_id": np.zeros(2)},
        "frame_id: is not one text of at most 256": {"xyz": points, "frame_id": np.array("f" * 300)},
        r"a\.npz: xyz: is damaged or contains objects": {"xyz": objects},
    }

    def read(content: dict[str, np.ndarray]) -> None:
        np.savez(tmp_path / "a.npz", **content)
        read_cloud(tmp_path / "a.npz")

    every_refusal(FileError, cases.items(), read)
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    _assert_refused(
        tmp_path / "a.npy",
        (tmp_path / "a.npy").read_bytes(),
        r"a\.npy: holds a pickled object .*convert it once: python -c",
    )
    with pytest.raises(FileError, match=r"a\.xyz: the extension is not one of \.pcd, \.ply, \.npz, \.npy"):
        read_cloud(tmp_path / "a.xyz")
    with pytest.raises(FileError, match="the extension is not one of"):
        write_cloud(tmp_path / "a", Cloud(np.zeros((1, 3), np.float32)))
    for suffix in CLOUD_SUFFIXES:
        with pytest.raises(FileError, match="No such file"):
            read_cloud(tmp_path / f"none{suffix}")
        with pytest.raises(FileError, match="No such file"):
            write_cloud(tmp_path / "none" / f"a{suffix}", Cloud(np.zeros((1, 3), np.float32)))


def test_a_refusal_of_an_array_names_no_content_of_another_file(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(b"root:x:0:0:root\n")
    with pytest.raises(FileError, match=r"a\.npy: is no \.npy array: it does not begin as one$"):
        read_cloud(path)
