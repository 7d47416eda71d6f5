# SPDX-License-Identifier: Apache-2.0
"""PLY and PCD with the optional parts of each format in all combinations hold the points that were drawn."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from foretouch.cloud.io.files import read_cloud
from foretouch.errors import FileError

WORDS = {
    "char": "b",
    "uchar": "B",
    "int16": "h",
    "ushort": "H",
    "int32": "i",
    "uint": "I",
    "float": "f",
    "float64": "d",
}
_NUMBER = st.floats(-4.0, 4.0, width=32).filter(lambda value: value != 0.0)
_POINT = st.one_of(st.tuples(_NUMBER, _NUMBER, _NUMBER), st.just((0.0, 0.0, 0.0)), st.just((np.nan,) * 3))
QUICK = settings(
    max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def expected(points: list[tuple[float, ...]]) -> Any:
    """The points as they are read: (0, 0, 0) is a pixel without depth."""
    xyz = np.array(points, np.float32).reshape(-1, 3)
    xyz[~xyz.any(axis=1)] = np.nan
    return xyz


FORMATS = {"ascii": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
COLOURS = ("red", "green", "blue")


class Ply:
    """Lines of the header and numbers of the data of a file that is being drawn."""

    def __init__(self, draw: Any, order: str) -> None:
        self.draw, self.order = draw, order
        self.lines = ["ply", f"format {FORMATS[order]} 1.0"]
        self.numbers: list[tuple[str, float]] = []  # of the data, with their types

    def add_list(self, kind: str, entries: list[int]) -> None:
        self.numbers += [("uchar", len(entries)), *((kind, entry) for entry in entries)]

    def add_any_list(self, kind: str) -> None:
        self.add_list(kind, self.draw(st.lists(st.integers(0, 9), max_size=3)))

    def add_camera(self) -> None:
        self.lines += ["element camera 1", "property float view", "property list uchar int32 names"]
        self.numbers.append(("float", 1.5))
        self.add_any_list("int32")

    def add_vertices(self, points: list[tuple[float, ...]], colours: Any) -> None:
        """Add the points, with further properties, in any order."""
        numbers, lists = st.sampled_from([*WORDS]), st.sampled_from(["int32", "float"])
        parts = [(axis, self.draw(st.sampled_from(["float", "float64"]))) for axis in "xyz"]
        parts += [(name, "uchar") for name in COLOURS if colours is not None]
        parts += [(f"more{k}", kind) for k, kind in enumerate(self.draw(st.lists(numbers, max_size=2)))]
        parts += [(f"row{k}", kind) for k, kind in enumerate(self.draw(st.lists(lists, max_size=1)))]
        parts = self.draw(st.permutations(parts))
        self.lines.append(f"element vertex {len(points)}")
        self.lines += [
            f"property {'list uchar ' if name.startswith('row') else ''}{kind} {name}" for name, kind in parts
        ]
        for k, point in enumerate(points):
            known = dict(zip("xyz", point, strict=True))
            known |= {} if colours is None else dict(zip(COLOURS, colours[k], strict=True))
            for name, kind in parts:
                if name.startswith("row"):
                    self.add_any_list(kind)
                else:
                    self.numbers.append((kind, known[name] if name in known else self.draw(st.integers(0, 99))))

    def add_grid(self, place: list[int]) -> None:
        self.lines += [f"element range_grid {len(place)}", "property list uchar int32 vertex_indices"]
        for pixel in place:
            self.add_list("int32", [pixel] if pixel >= 0 else [])

    def content(self) -> bytes:
        newline = self.draw(st.sampled_from(["\n", "\r\n"]))
        head = newline.join([*self.lines, "end_header", ""]).encode()
        if self.order != "ascii":
            return head + b"".join(struct.pack(self.order + WORDS[kind], value) for kind, value in self.numbers)
        gaps = st.sampled_from([" ", "\n", " \r\n"])  # lines have no meaning
        return head + "".join(f"{value!r}{self.draw(gaps)}" for _, value in self.numbers).encode()


@st.composite
def ply_files(draw: Any) -> tuple[bytes, Any, Any]:
    """A file, its points as they are read, and its colours."""
    ply, points = Ply(draw, draw(st.sampled_from([*FORMATS]))), draw(st.lists(_POINT, max_size=7))
    some = st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=len(points), max_size=len(points))
    colours = draw(st.none() | some)
    remarks = st.sampled_from(["comment made up", "obj_info is_mesh 0", "comment end_header of it"])
    ply.lines += draw(st.lists(remarks, max_size=2))
    xyz, rgb = expected(points), None if colours is None else np.array(colours, np.uint8).reshape(-1, 3)
    place = None
    if draw(st.booleans()) and points:  # an image whose pixels are in their own element
        pixels = st.lists(st.integers(-1, len(points) - 1), min_size=4, max_size=6)
        place = draw(pixels.filter(lambda drawn: len(drawn) % 2 == 0))
        ply.lines += ["obj_info num_cols 2", f"obj_info num_rows {len(place) // 2}"]
        index = np.array(place).reshape(-1, 2)
        rgb = None if rgb is None else np.where(index[..., None] >= 0, rgb[index], 0)
        xyz = np.where(index[..., None] >= 0, xyz[index], np.nan)
    if draw(st.booleans()):
        ply.add_camera()
    ply.add_vertices(points, colours)
    if draw(st.booleans()):
        ply.lines += ["element face 1", "property list uchar int32 vertex_indices"]
        ply.add_any_list("int32")
    if place is not None:
        ply.add_grid(place)
    return ply.content(), xyz, rgb


@QUICK
@given(ply_files())
def test_any_ply_holds_its_points(tmp_path: Path, file: tuple[bytes, Any, Any]) -> None:
    content, xyz, rgb = file
    (tmp_path / "a.ply").write_bytes(content)
    cloud = read_cloud(tmp_path / "a.ply")
    assert_array_equal(cloud.xyz, xyz)
    assert_array_equal(cloud.rgb, rgb)


@QUICK
@given(ply_files(), st.data())
def test_a_ply_that_is_cut_off_is_refused_or_keeps_its_points(
    tmp_path: Path, file: tuple[bytes, Any, Any], data: Any
) -> None:
    content, xyz, _ = file
    (tmp_path / "a.ply").write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        cloud = read_cloud(tmp_path / "a.ply")
    except FileError:
        return
    flat = xyz.reshape(-1, 3)
    same = (cloud.xyz.reshape(-1, 3) == flat) | np.isnan(flat)
    assert same[:-1].all()  # the last number of a text may have lost digits


@st.composite
def pcd_files(draw: Any) -> tuple[bytes, Any]:
    """A file, and its points as they are read."""
    width, height = draw(st.sampled_from([(0, 1), (1, 1), (5, 1), (2, 3)]))
    points = draw(st.lists(_POINT, min_size=width * height, max_size=width * height))
    fields = [(axis, "F", draw(st.sampled_from([4, 8])), 1) for axis in "xyz"]
    more = st.tuples(
        st.sampled_from(["intensity", "_", "label"]),
        st.sampled_from([("F", 4), ("U", 2), ("I", 1), ("U", 8)]),
        st.integers(1, 3),
    )
    fields += [
        (name, *kind, count) for name, kind, count in draw(st.lists(more, max_size=2, unique_by=lambda one: one[0]))
    ]
    fields = draw(st.permutations(fields))
    version, counted, counts, viewpoint = (draw(st.booleans()) for _ in range(4))
    text = draw(st.booleans())
    lines = ["# .PCD v0.7"] * version + [f"VERSION {'0.7' if version else '.5'}"]
    lines += [
        f"{name} {' '.join(str(field[k]) for field in fields)}" for k, name in enumerate(["FIELDS", "TYPE", "SIZE"])
    ]
    if counts or any(field[3] > 1 for field in fields):
        lines.append(f"COUNT {' '.join(str(field[3]) for field in fields)}")
    lines += (
        [f"WIDTH {width}", f"HEIGHT {height}"]
        + ["VIEWPOINT 0 0 0 1 0 0 0"] * viewpoint
        + [f"POINTS {len(points)}"] * counted
    )
    lines.append(f"DATA {'ascii' if text else 'binary'}")
    rows = []
    for point in points:
        values = [
            point["xyz".index(name)] if name in "xyz" else 7 for name, _, _, count in fields for _ in range(count)
        ]
        kinds = [(kind, size) for _, kind, size, count in fields for _ in range(count)]
        if text:
            rows.append((" ".join(repr(value) for value in values) + "\n").encode())
        else:
            letters = {("F", 4): "f", ("F", 8): "d", ("U", 2): "H", ("I", 1): "b", ("U", 8): "Q"}
            rows.append(struct.pack("<" + "".join(letters[kind] for kind in kinds), *values))
    xyz = expected(points)
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    return newline.join([*lines, ""]).encode() + b"".join(rows), xyz.reshape(height, width, 3) if height > 1 else xyz


@QUICK
@given(pcd_files())
def test_any_pcd_holds_its_points(tmp_path: Path, file: tuple[bytes, Any]) -> None:
    content, xyz = file
    (tmp_path / "a.pcd").write_bytes(content)
    assert_array_equal(read_cloud(tmp_path / "a.pcd").xyz, xyz)


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".ply", ".pcd"])
def test_points_at_the_camera_have_no_depth_in_any_file(tmp_path: Path, suffix: str) -> None:
    from foretouch.cloud.io.files import write_cloud
    from foretouch.types import Cloud

    xyz = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [-0.0, 0.0, 0.0]], np.float32)
    write_cloud(tmp_path / f"a{suffix}", Cloud(xyz))
    assert_array_equal(read_cloud(tmp_path / f"a{suffix}").xyz, [[np.nan] * 3, [0.0, 0.0, 1.0], [np.nan] * 3])
