# SPDX-License-Identifier: Apache-2.0
"""Read and write the vertices of PLY files (Stanford polygon format) as clouds.

The shape of an organised cloud is in the two `obj_info` lines `num_cols` and `num_rows`, as in Stanford's range scans.
"""

from pathlib import Path

import numpy as np

from foretouch.cloud.io.records import (
    HEADER_LIMIT,
    SIZE_LIMIT,
    ascii_records,
    binary_records,
    point_dtype,
    to_cloud,
    whole_number,
)
from foretouch.errors import FileError
from foretouch.files import read_bytes
from foretouch.types import AnyArray, Cloud

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
}
_TYPES |= {np.dtype(kind).name: kind for kind in _TYPES.values()}  # int8 and so on
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS = ("red", "green", "blue")


def read_ply(path: Path) -> Cloud:
    """Read the vertices of an ASCII or binary PLY file, which must be its first element.

    Returns:
        (H, W, 3) if `obj_info` gives the shape, else (N, 3), with colours of red, green and blue of uchar.

    Raises:
        FileError: If the header is incomplete, there is no x, y, z, or the data is truncated.
        OSError: If the file cannot be read.
    """
    content = read_bytes(path, SIZE_LIMIT)
    if not content.startswith(b"ply"):
        raise FileError(path, "does not start with ply", field="header")
    end = content.find(b"end_header", 0, HEADER_LIMIT)
    newline = content.find(b"\n", end)
    if end < 0 or newline < 0:
        raise FileError(path, "no line end_header: truncated", field="header")
    encoding, numbers, properties = _header(path, content[:end].decode("ascii", errors="replace"))
    if encoding not in _ORDERS:
        raise FileError(path, f"{encoding or 'nothing'} is not one of {', '.join(_ORDERS)}", field="format")
    if "element vertex" not in numbers:
        raise FileError(path, "element vertex is missing", field="header")
    points = numbers["element vertex"]
    columns, rows = numbers.get("num_cols", points), numbers.get("num_rows", 1)
    if columns * rows != points:
        raise FileError(path, f"{columns} x {rows} is not the number of vertices, {points}", field="obj_info")
    dtype = point_dtype(path, [(name, _ORDERS[encoding] + kind) for name, kind in properties], "property")
    body = content[newline + 1 :]
    if encoding == "ascii":
        records = ascii_records(path, body, dtype, points, "vertex", alone=False)
    else:
        records = binary_records(path, body, dtype, points, "vertex")
    coloured = {(name, "u1") for name in _COLOURS} <= set(properties)
    rgb = np.stack([records[name] for name in _COLOURS], axis=-1) if coloured else None
    return to_cloud(records, rgb, rows, columns)


def write_ply(path: Path, cloud: Cloud) -> None:
    """Write a binary PLY file: x, y, z as float, and red, green, blue as uchar."""
    parts: list[tuple[str, str]] = [(name, "<f4") for name in "xyz"]
    if cloud.rgb is not None:
        parts += [(name, "u1") for name in _COLOURS]
    records: AnyArray = np.empty(cloud.size, parts)
    for k, (name, _) in enumerate(parts):
        records[name] = (cloud.xyz if k < 3 or cloud.rgb is None else cloud.rgb)[..., k % 3].reshape(-1)
    lines = ["ply", "format binary_little_endian 1.0"]
    if cloud.organised:
        lines += [f"obj_info num_cols {cloud.xyz.shape[1]}", f"obj_info num_rows {cloud.xyz.shape[0]}"]
    lines.append(f"element vertex {cloud.size}")
    lines += [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in parts]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode("ascii") + records.tobytes())


def _header(path: Path, text: str) -> tuple[str, dict[str, int], list[tuple[str, str]]]:
    """The format; sizes of elements and image by name; and name and NumPy type of each property of a vertex."""
    encoding = element = ""
    numbers: dict[str, int] = {}
    properties: list[tuple[str, str]] = []
    for line in text.splitlines():
        match words := line.split():
            case ["format", encoding, *_]:
                pass
            case ["obj_info", ("num_cols" | "num_rows") as name, count]:
                numbers[name] = whole_number(path, count, name)
            case ["element", name, count]:
                if element == "" and name != "vertex":
                    raise FileError(path, f"{name} comes before the vertices", field="element")
                element = name
                numbers[f"element {name}"] = whole_number(path, count, f"element {name}")
            case ["property", *_] if element == "vertex":
                if len(words) != 3 or words[1] not in _TYPES:
                    raise FileError(path, f"{' '.join(words[1:])}: is not a plain number", field="property")
                properties.append((words[2], _TYPES[words[1]]))
    return encoding, numbers, properties
