# SPDX-License-Identifier: Apache-2.0
"""Read and write PCD files (version 0.7 of the Point Cloud Library), organised or not.

They are decoded here: real recordings consist of many small files, and Open3D takes half a second to import, drops the
image order, and only warns about a truncated file. Compressed data are LZF, and hold all values of one field before those
of the next. VIEWPOINT is ignored: clouds are in their own frame.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.checked_files import read_bytes
from foretouch.cloud.io.numpy_files import SIZE_LIMIT, check_unpacked
from foretouch.errors import FileError, shown
from foretouch.types import Cloud, UInt8

_KINDS = {"F": "f", "I": "i", "U": "u"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_HEADER_LIMIT = 65536  # bytes within which DATA must occur
_COUNT_LIMIT = 65536  # numbers of one field; the largest descriptors of the Point Cloud Library have about 2000
_REQUIRED = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA")


@dataclass(frozen=True)
class _Header:
    """The text before the data."""

    dtype: np.dtype[Any]  # type of one point, unaligned, little-endian
    width: int  # points per row
    height: int  # rows
    data: str  # "ascii", "binary" or "binary_compressed"
    size: int  # size of the header [bytes]

    @property
    def points(self) -> int:
        return self.width * self.height

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.height, self.width) if self.height > 1 and self.width else (self.points,)


def read_pcd(path: Path) -> Cloud:
    """Read a PCD file: (H, W, 3) if HEIGHT is above 1, else (N, 3), with colours of a field `rgb` or `rgba`.

    Raises:
        FileError: If the header is incomplete, contradicts itself or the data, or there is no x, y, z.
        OSError: If the file cannot be read.
    """
    content = read_bytes(path, SIZE_LIMIT)
    header = _parse_header(path, content)
    body = content[header.size :]
    if header.data == "binary_compressed":
        records = _unpacked_records(path, header, body)
    elif header.data == "binary":
        expected = header.points * header.dtype.itemsize
        if len(body) < expected:
            raise FileError(
                path,
                f"{len(body)} bytes are fewer than {header.points} points of {header.dtype.itemsize} = {expected}",
                field="DATA",
            )
        records = np.frombuffer(body, header.dtype, header.points)  # PCL pads files to whole pages
    else:
        words, columns = body.split(), sum(int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ())
        if len(words) != header.points * columns:
            rule = f"{len(words)} numbers are not {header.points} points of {columns} = {header.points * columns}"
            raise FileError(path, rule, field="DATA")
        records = ascii_records(path, words, header.points, header.dtype, "DATA")
    xyz = np.stack([records[name].astype(np.float32) for name in "xyz"], axis=-1)
    rgb = _colours(path, records)
    return Cloud(xyz.reshape(*header.shape, 3), None if rgb is None else rgb.reshape(*header.shape, 3))


def write_pcd(path: Path, cloud: Cloud) -> None:
    """Write a binary PCD file: x, y, z as float32, and rgb packed into a fourth."""
    height, width = cloud.xyz.shape[:2] if cloud.organised else (1, cloud.size)
    names = ["x", "y", "z"] if cloud.rgb is None else ["x", "y", "z", "rgb"]
    columns = np.empty((cloud.size, len(names)), "<f4")
    columns[:, :3] = cloud.xyz.reshape(-1, 3)
    if cloud.rgb is not None:
        r, g, b = cloud.rgb.reshape(-1, 3).astype(np.uint32).T
        columns.view("<u4")[:, 3] = (r << 16) | (g << 8) | b
    count = len(names)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(names)}\nSIZE{' 4' * count}\nTYPE{' F' * count}\nCOUNT{' 1' * count}\n"
        f"WIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {cloud.size}\nDATA binary\n"
    )
    path.write_bytes(header.encode("ascii") + columns.tobytes())


def _parse_header(path: Path, content: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = content.find(b"\n", start, _HEADER_LIMIT)
        if end < 0:
            raise FileError(path, "no line DATA: not a PCD file, or truncated", field="header")
        words = content[start:end].decode("ascii", errors="replace").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    for name in _REQUIRED:
        if not entries.get(name):
            raise FileError(path, "is missing in the header", field=name)
    width, height = (_whole(path, entries, name) for name in ("WIDTH", "HEIGHT"))
    points = _whole(path, entries, "POINTS") if "POINTS" in entries else width * height
    if points != width * height:
        raise FileError(path, f"{points} is not WIDTH {width} x HEIGHT {height}", field="POINTS")
    data = entries["DATA"][0].lower()
    if data not in ("ascii", "binary", "binary_compressed"):
        raise FileError(path, f"{data} is none of ascii, binary, binary_compressed", field="DATA")
    return _Header(_dtype(path, entries), width, height, data, start)


def _whole(path: Path, entries: dict[str, list[str]], name: str) -> int:
    text = " ".join(entries[name])
    return whole_number(path, text, name)


def whole_number(path: Path, text: str, field: str) -> int:
    """A number of points in a header; a `FileError` if it is not a whole number below 2^31."""
    if not text.isdecimal():
        raise FileError(path, f"{shown(text)!r} is not a whole number", field=field)
    digits = text.lstrip("0") or "0"
    if len(digits) > 10 or int(digits) >= 2**31:
        raise FileError(path, f"{shown(text, 40)} is not below 2^31", field=field)
    return int(digits)


def _dtype(path: Path, entries: dict[str, list[str]]) -> np.dtype[Any]:
    fields = entries["FIELDS"]
    counts = entries.get("COUNT", ["1"] * len(fields))
    for name, values in (("SIZE", entries["SIZE"]), ("TYPE", entries["TYPE"]), ("COUNT", counts)):
        if len(values) != len(fields):
            raise FileError(path, f"{len(values)} entries for {len(fields)} FIELDS", field=name)
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for i, (field, size, kind, count) in enumerate(zip(fields, entries["SIZE"], entries["TYPE"], counts, strict=True)):
        if kind not in _KINDS or size not in map(str, _SIZES[kind]):
            raise FileError(path, f"TYPE {kind} of SIZE {size} is no number", field=field)
        if not count.isdecimal() or not count.strip("0"):
            raise FileError(path, f"COUNT {shown(count)} is not a positive number", field=field)
        if whole_number(path, count, "COUNT") > _COUNT_LIMIT:
            raise FileError(path, f"COUNT {count} exceeds {_COUNT_LIMIT}", field=field)
        name = f"_{i}" if field == "_" else field  # padding may occur several times
        parts.append((name, f"<{_KINDS[kind]}{size}", (int(count),) if int(count) > 1 else ()))
    names = [name for name, _, _ in parts]
    if len(set(names)) != len(names):
        raise FileError(path, f"{' '.join(fields)}: a name occurs twice", field="FIELDS")
    for axis in "xyz":
        part = next((part for part in parts if part[0] == axis), None)
        if part is None:
            raise FileError(path, f"{axis} is missing; there are: {' '.join(fields)}", field="FIELDS")
        if part[1][1] != "f" or part[2]:
            raise FileError(path, "is not one floating number", field=axis)
    return np.dtype(parts)


def ascii_records(path: Path, words: list[bytes], points: int, dtype: np.dtype[Any], field: str) -> npt.NDArray[Any]:
    """(points,) records of a structured type from numbers in text; a `FileError` if a word is not a number."""
    names = dtype.names or ()
    widths = [int(np.prod(dtype[name].shape)) for name in names]
    try:
        table = np.array(words, np.float64).reshape(points, sum(widths))
    except ValueError as err:
        raise FileError(path, f"not a number: {shown(str(err))}", field=field) from err
    records = np.zeros(points, dtype)
    columns = np.split(table, np.cumsum(widths)[:-1], axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        for name, column in zip(names, columns, strict=True):
            records[name] = column.reshape(records[name].shape)
    return records


def _unpacked_records(path: Path, header: _Header, body: bytes) -> npt.NDArray[Any]:
    """(points,) records of compressed data, which start with their sizes before and after compression."""
    if header.points == 0:
        return np.zeros(0, header.dtype)
    if len(body) < 8:
        raise FileError(path, "is truncated before the sizes of the compressed data", field="DATA")
    packed, unpacked = (int(n) for n in np.frombuffer(body[:8], "<u4"))
    if len(body) - 8 < packed:
        raise FileError(path, f"{len(body) - 8} bytes are fewer than the {packed} of compressed data", field="DATA")
    expected = header.points * header.dtype.itemsize
    check_unpacked(path, expected, len(body), "DATA")
    if unpacked != expected:
        raise FileError(path, f"unpacks to {unpacked} bytes, not to {header.points} points = {expected}", field="DATA")
    import lzf

    try:
        content = lzf.decompress(body[8 : 8 + packed], unpacked)
    except ValueError as err:
        raise FileError(path, f"is no LZF data: {err}", field="DATA") from err
    if content is None or len(content) != unpacked:
        raise FileError(path, f"does not unpack to the {unpacked} bytes that it names", field="DATA")
    records, start = np.zeros(header.points, header.dtype), 0
    for name in header.dtype.names or ():
        kind = header.dtype[name]
        column = np.frombuffer(content, kind.base, header.points * kind.itemsize // kind.base.itemsize, start)
        records[name] = column.reshape(records[name].shape)
        start += column.nbytes
    return records


def _colours(path: Path, records: npt.NDArray[Any]) -> UInt8 | None:
    """(N, 3) from four packed bytes: blue lowest, then green and red."""
    name = next((name for name in ("rgb", "rgba") if name in (records.dtype.names or ())), None)
    if name is None:
        return None
    if records.dtype[name].itemsize != 4 or records.dtype[name].shape:
        raise FileError(path, "is not one number of 4 bytes", field=name)
    packed = np.ascontiguousarray(records[name])
    return packed.view(np.uint8).reshape(-1, 4)[:, 2::-1].copy()
