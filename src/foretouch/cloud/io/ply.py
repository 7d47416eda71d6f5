# SPDX-License-Identifier: Apache-2.0
"""Read and write the vertices of PLY files (Stanford polygon format) as clouds.

Decoded here, since Open3D fills a truncated file with zeros and only warns. The shape of an organised cloud is in the
two `obj_info` lines `num_cols` and `num_rows`, as in Stanford's range scans.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.checked_files import read_bytes
from foretouch.cloud.io.numpy_files import SIZE_LIMIT
from foretouch.cloud.io.pcd import ascii_records, whole_number
from foretouch.errors import FileError
from foretouch.types import Cloud, UInt8

_HEADER_LIMIT = 65536  # bytes within which end_header must occur
# The two PLY names of each NumPy type.
_NAMES = "i1 char int8, u1 uchar uint8, i2 short int16, u2 ushort uint16, i4 int int32, u4 uint uint32, "
_NAMES += "f4 float float32, f8 double float64"
_TYPES = {name: kind for kind, *names in map(str.split, _NAMES.split(",")) for name in names}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS = ("red", "green", "blue")


@dataclass
class _Header:
    """The text before the data."""

    encoding: str = ""  # key of `_ORDERS`
    points: int = -1  # number of vertices
    properties: list[tuple[str, str]] = field(default_factory=list)  # name and NumPy type of each property of a vertex
    image: dict[str, int] = field(default_factory=dict)  # `num_cols` and `num_rows`, if given


def read_ply(path: Path) -> Cloud:
    """Read the vertices of an ASCII or binary PLY file, which must be its first element.

    Returns:
        (H, W, 3) if `obj_info` gives the shape, else (N, 3), with colours of red, green and blue of uchar.

    Raises:
        FileError: If the header is incomplete, there is no x, y, z, or the data is truncated.
        OSError: If the file cannot be read.
    """
    content = read_bytes(path, SIZE_LIMIT)
    header, size = _parse_header(path, content)
    columns, rows = header.image.get("num_cols", header.points), header.image.get("num_rows", 1)
    if columns * rows != header.points:
        raise FileError(path, f"{columns} x {rows} is not the number of vertices, {header.points}", field="obj_info")
    vertices = _vertices(path, header, content[size:])
    shape = (rows, columns, 3) if rows > 1 and columns else (header.points, 3)
    with np.errstate(over="ignore"):
        xyz = np.stack([vertices[name].astype(np.float32) for name in "xyz"], axis=-1)
    rgb = _colours(vertices)
    return Cloud(xyz.reshape(shape), None if rgb is None else rgb.reshape(shape))


def write_ply(path: Path, cloud: Cloud) -> None:
    """Write a binary PLY file: x, y, z as float, and red, green, blue as uchar."""
    parts: list[tuple[str, str]] = [(name, "<f4") for name in "xyz"]
    if cloud.rgb is not None:
        parts += [(name, "u1") for name in _COLOURS]
    records: npt.NDArray[Any] = np.empty(cloud.size, parts)
    for i, name in enumerate("xyz"):
        records[name] = cloud.xyz[..., i].reshape(-1)
    if cloud.rgb is not None:
        for i, name in enumerate(_COLOURS):
            records[name] = cloud.rgb[..., i].reshape(-1)
    lines = ["ply", "format binary_little_endian 1.0"]
    if cloud.organised:
        lines += [f"obj_info num_cols {cloud.xyz.shape[1]}", f"obj_info num_rows {cloud.xyz.shape[0]}"]
    lines.append(f"element vertex {cloud.size}")
    lines += [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in parts]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode("ascii") + records.tobytes())


def _parse_header(path: Path, content: bytes) -> tuple[_Header, int]:
    """The header, and its size [bytes]."""
    if not content.startswith(b"ply"):
        raise FileError(path, "does not start with ply", field="header")
    end = content.find(b"end_header", 0, _HEADER_LIMIT)
    newline = content.find(b"\n", end)
    if end < 0 or newline < 0:
        raise FileError(path, "no line end_header: truncated", field="header")
    header = _Header()
    element = ""
    for line in content[:end].decode("ascii", errors="replace").splitlines():
        element = _parse_line(path, header, line.split(), element)
    if header.encoding not in _ORDERS:
        raise FileError(path, f"{header.encoding or 'nothing'} is none of {', '.join(_ORDERS)}", field="format")
    if header.points < 0:
        raise FileError(path, "element vertex is missing", field="header")
    names = [name for name, _ in header.properties]
    if len(set(names)) != len(names):
        raise FileError(path, f"{' '.join(names)}: a name occurs twice", field="property")
    for axis in "xyz":
        if axis not in names:
            raise FileError(path, f"is no property of the vertices; there are: {' '.join(names)}", field=axis)
    return header, newline + 1


def _parse_line(path: Path, header: _Header, words: list[str], element: str) -> str:
    """Parse one line of the header; returns the element to which the next line belongs."""
    match words:
        case ["format", encoding, *_]:
            header.encoding = encoding
        case ["obj_info", ("num_cols" | "num_rows") as name, count]:
            header.image[name] = whole_number(path, count, name)
        case ["element", name, count]:
            if element == "" and name != "vertex":
                raise FileError(path, f"{name} comes before the vertices", field="element")
            number = whole_number(path, count, f"element {name}")
            if name == "vertex":
                header.points = number
            return name
        case ["property", kind, *rest] if element == "vertex":
            if kind not in _TYPES or len(rest) != 1:
                raise FileError(path, f"{' '.join([kind, *rest])}: is no plain number", field="property")
            header.properties.append((rest[0], _TYPES[kind]))
    return element


def _vertices(path: Path, header: _Header, body: bytes) -> npt.NDArray[Any]:
    points, columns = header.points, len(header.properties)
    dtype = np.dtype([(name, _ORDERS[header.encoding] + kind) for name, kind in header.properties])
    if header.encoding == "ascii":
        words = body.split(None, points * columns)[: points * columns]
        if len(words) < points * columns:
            rule = f"{len(words)} numbers are fewer than {points} x {columns} = {points * columns}"
            raise FileError(path, rule, field="vertex")
        return ascii_records(path, words, points, dtype, "vertex")
    expected = points * dtype.itemsize
    if len(body) < expected:
        rule = f"{len(body)} bytes are fewer than {points} of {dtype.itemsize} = {expected}"
        raise FileError(path, rule, field="vertex")
    return np.frombuffer(body, dtype, points)


def _colours(vertices: npt.NDArray[Any]) -> UInt8 | None:
    names = vertices.dtype.names or ()
    if not all(name in names and vertices.dtype[name] == np.uint8 for name in _COLOURS):
        return None
    return np.stack([vertices[name] for name in _COLOURS], axis=-1)
