# SPDX-License-Identifier: Apache-2.0
"""Read and write PCD files (version 0.7 of the Point Cloud Library), organised or not.

Compressed data are LZF, and hold all values of one field before those of the next. VIEWPOINT is ignored: clouds are in
their own frame.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.cloud.io.pointcloud2 import encode
from foretouch.cloud.io.records import (
    HEADER_LIMIT,
    SIZE_LIMIT,
    Records,
    ascii_records,
    binary_records,
    check_unpacked,
    point_dtype,
    to_cloud,
    whole_number,
)
from foretouch.errors import FileError
from foretouch.files import read_bytes
from foretouch.types import Cloud, UInt8

_SIZES = {"F": "48", "I": "1248", "U": "1248"}
_POINT_LIMIT = 20_000_000  # of a cloud: ten images of 1920x1080


def read_pcd(path: Path) -> Cloud:
    """Read a PCD file: (H, W, 3) if HEIGHT is above 1, else (N, 3), with colours of a field `rgb` or `rgba`.

    Raises:
        FileError: If the header is incomplete, contradicts itself or the data, or there is no x, y, z.
        OSError: If the file cannot be read.
    """
    content = read_bytes(path, SIZE_LIMIT)
    entries, start = _header(path, content)
    width, height = (whole_number(path, " ".join(entries[name]), name) for name in ("WIDTH", "HEIGHT"))
    points = width * height
    if points > _POINT_LIMIT:
        raise FileError(path, f"WIDTH {width} x HEIGHT {height} exceeds {_POINT_LIMIT} points", field="WIDTH")
    if "POINTS" in entries and whole_number(path, " ".join(entries["POINTS"]), "POINTS") != points:
        raise FileError(path, f"{entries['POINTS'][0]} is not WIDTH {width} x HEIGHT {height}", field="POINTS")
    dtype, body = _dtype(path, entries), content[start:]
    match data := entries["DATA"][0].lower():
        case "ascii":
            records = ascii_records(path, body, dtype, points, "DATA", alone=True)
        case "binary":  # PCL pads files to whole pages
            records = binary_records(path, body, dtype, points, "DATA")
        case "binary_compressed":
            records = _unpacked(path, body, dtype, points)
        case _:
            raise FileError(path, f"{data} is not one of ascii, binary, binary_compressed", field="DATA")
    return to_cloud(records, _colours(records), height, width)


def write_pcd(path: Path, cloud: Cloud) -> None:
    """Write a binary PCD file: x, y, z as float32, and rgb packed into a fourth."""
    layout = encode(cloud)
    count = len(layout.fields)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(one.name for one in layout.fields)}\n"
        f"SIZE{' 4' * count}\nTYPE{' F' * count}\nCOUNT{' 1' * count}\nWIDTH {layout.width}\nHEIGHT {layout.height}\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {cloud.size}\nDATA binary\n"
    )
    path.write_bytes(header.encode("ascii") + layout.data.tobytes())


def _header(path: Path, content: bytes) -> tuple[dict[str, list[str]], int]:
    """The words of each line by its first, and where the data begin."""
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = content.find(b"\n", start, HEADER_LIMIT)
        if end < 0:
            raise FileError(path, "no line DATA: not a PCD file, or truncated", field="header")
        words = content[start:end].decode("ascii", errors="replace").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    for name in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA"):
        if not entries.get(name):
            raise FileError(path, "is missing in the header", field=name)
    return entries, start


def _dtype(path: Path, entries: dict[str, list[str]]) -> np.dtype[Any]:
    """Of one point, unaligned, little-endian; padding gets names that no field can have."""
    fields = entries["FIELDS"]
    columns = [fields, entries["TYPE"], entries["SIZE"], entries.get("COUNT", ["1"] * len(fields))]
    for name, values in zip(("TYPE", "SIZE", "COUNT"), columns[1:], strict=True):
        if len(values) != len(fields):
            raise FileError(path, f"{len(values)} entries for {len(fields)} FIELDS", field=name)
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for i, (field, kind, size, count) in enumerate(zip(*columns, strict=True)):
        if len(size) != 1 or size not in _SIZES.get(kind, ""):
            raise FileError(path, f"TYPE {kind} of SIZE {size} is not a number", field=field)
        number = whole_number(path, count, f"COUNT of {field}")
        if field in ("rgb", "rgba") and (size, number) != ("4", 1):
            raise FileError(path, "is not one number of 4 bytes", field=field)
        name = f"_ {i}" if field == "_" else field
        parts.append((name, f"<{kind.lower()}{size}", () if number == 1 else (number,)))
    return point_dtype(path, parts, "FIELDS")


def _unpacked(path: Path, body: bytes, dtype: np.dtype[Any], points: int) -> Records:
    """Records of compressed data, which start with their sizes before and after compression."""
    if points == 0:
        return np.zeros(0, dtype)
    packed, unpacked = struct.unpack_from("<II", body.ljust(8, b"\0"))
    expected = points * dtype.itemsize
    check_unpacked(path, expected, len(body), "DATA")
    if len(body) - 8 < packed or unpacked != expected:
        rule = f"{len(body) - 8} bytes of {packed} unpack to {unpacked} bytes, not to {points} points = {expected}"
        raise FileError(path, rule, field="DATA")
    import lzf

    try:
        content = lzf.decompress(body[8 : 8 + packed], unpacked)
    except ValueError:
        content = None
    if content is None or len(content) != unpacked:
        raise FileError(path, f"is not LZF data of {unpacked} bytes", field="DATA")
    records, start = np.zeros(points, dtype), 0
    for name in dtype.names or ():
        kind = dtype[name]
        records[name] = np.ndarray((points, *kind.shape), kind.base, content, start)
        start += points * kind.itemsize
    return records


def _colours(records: Records) -> UInt8 | None:
    """(N, 3) from four packed bytes: blue lowest, then green and red."""
    name = next((name for name in ("rgb", "rgba") if name in (records.dtype.names or ())), None)
    if name is None:
        return None
    return np.ascontiguousarray(records[name]).view(np.uint8).reshape(-1, 4)[:, 2::-1].copy()
