# SPDX-License-Identifier: Apache-2.0
"""Read and write point clouds as PCD files (version 0.7 of the Point Cloud Library) and PLY files (the vertices).

Both are decoded here: the libraries for them take the memory that a header asks for (plyfile, which is GPL besides), return
fewer points of a truncated file (pypcd4), or fill up with zeros and warn (Open3D). What a header declares is compared with
the file before memory is taken. Text of PLY is a series of numbers, however it is divided into lines; text of PCD has a line for each point.

Compressed data of PCD are LZF, and hold all values of one field before the next field; VIEWPOINT is ignored, since clouds
are in their own frame. The shape of an organised cloud in PLY is in the two `obj_info` lines `num_cols` and `num_rows`, as in
Stanford's range scans.
"""

import io
import re
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured

from foretouch.base.files import read_bytes
from foretouch.cloud.io.pointcloud2 import encode
from foretouch.errors import FileError, shown
from foretouch.types import AnyArray, Cloud, UInt8

SIZE_LIMIT: Final = 1_000_000_000  # of a file with a cloud [bytes]
_HEADER_LIMIT: Final = 65536  # bytes within which a header must end
_POINT_LIMIT: Final = 20_000_000  # of a cloud: ten images of 1920x1080
_LONG_LINE: Final = re.compile(rb"[^\n]{65535}")
_SIZES: Final = {"F": "48", "I": "1248", "U": "1248"}
_TYPES: Final = dict(
    zip(
        ("char", "uchar", "short", "ushort", "int", "uint", "float", "double"),
        ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"),
        strict=True,
    )
)
_NAMES: Final = _TYPES | {np.dtype(kind).name: kind for kind in _TYPES.values()}  # int8 and so on
_ORDERS: Final = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS: Final = ("red", "green", "blue")
_PLY_END: Final = re.compile(rb"[\r\n]end_header[ \t]*(?:\r\n|\n|\r)")

_Records = AnyArray  # (N,) of a structured dtype


def read_pcd(path: Path) -> Cloud:
    """Read a PCD file: (H, W, 3) if HEIGHT is above 1, else (N, 3), with colours of a field `rgb` or `rgba`.

    Raises:
        FileError: If the header is incomplete, contradicts itself or the data, or there is no x, y, z.
        OSError: If the file cannot be read.
    """
    content = read_bytes(path, SIZE_LIMIT)
    entries, start = _pcd_header(path, content)
    width, height = (_whole_number(path, " ".join(entries[name]), name) for name in ("WIDTH", "HEIGHT"))
    points = width * height
    if points > _POINT_LIMIT:
        raise FileError(path, f"WIDTH {width} x HEIGHT {height} exceeds {_POINT_LIMIT} points", field="WIDTH")
    if "POINTS" in entries and _whole_number(path, " ".join(entries["POINTS"]), "POINTS") != points:
        raise FileError(path, f"{entries['POINTS'][0]} is not WIDTH {width} x HEIGHT {height}", field="POINTS")
    dtype, data = _pcd_dtype(path, entries), entries["DATA"][0].lower()
    if data not in ("ascii", "binary", "binary_compressed"):
        raise FileError(path, f"{data} is not one of ascii, binary, binary_compressed", field="DATA")
    if data == "binary_compressed":
        records = _unpacked(path, content[start:], dtype, points)
    else:
        records = _records(path, content[start:], dtype, points, "DATA", text=data == "ascii")
    return _to_cloud(records, _colours(records), height, width)


def pcd_bytes(cloud: Cloud) -> bytes:
    """Return the content of a binary PCD file: x, y, z as float32, and rgb packed into a fourth."""
    layout = encode(cloud)
    count = len(layout.fields)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(field.name for field in layout.fields)}\n"
        f"SIZE{' 4' * count}\nTYPE{' F' * count}\nCOUNT{' 1' * count}\nWIDTH {layout.width}\nHEIGHT {layout.height}\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {cloud.size}\nDATA binary\n"
    )
    return header.encode("ascii") + bytes(layout.data.data)


def _pcd_header(path: Path, content: bytes) -> tuple[dict[str, list[str]], int]:
    """Return the words of each line by its first, and where the data begin."""
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
    for name in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA"):
        if not entries.get(name):
            raise FileError(path, "is missing in the header", field=name)
    return entries, start


def _pcd_dtype(path: Path, entries: dict[str, list[str]]) -> np.dtype[Any]:
    """Make the type of a point, unaligned, little-endian; padding gets names that no field can have."""
    fields = entries["FIELDS"]
    columns = [fields, entries["TYPE"], entries["SIZE"], entries.get("COUNT", ["1"] * len(fields))]
    for name, values in zip(("TYPE", "SIZE", "COUNT"), columns[1:], strict=True):
        if len(values) != len(fields):
            raise FileError(path, f"{len(values)} entries for {len(fields)} FIELDS", field=name)
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for i, (field, kind, size, count) in enumerate(zip(*columns, strict=True)):
        if len(size) != 1 or size not in _SIZES.get(kind, ""):
            raise FileError(path, f"TYPE {kind} of SIZE {size} is not a number", field=field)
        number = _whole_number(path, count, f"COUNT of {field}")
        if field in ("rgb", "rgba") and (size, number) != ("4", 1):
            raise FileError(path, "is not one number of 4 bytes", field=field)
        name = f"_ {i}" if field == "_" else field
        parts.append((name, f"<{kind.lower()}{size}", () if number == 1 else (number,)))
    return _point_dtype(path, parts, "FIELDS")


def _unpacked(path: Path, body: bytes, dtype: np.dtype[Any], points: int) -> _Records:
    """Return the records of compressed data, which start with their sizes before and after compression."""
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


def _colours(records: _Records) -> UInt8 | None:
    """Return (N, 3) from four packed bytes: blue lowest, then green and red."""
    name = next((name for name in ("rgb", "rgba") if name in (records.dtype.names or ())), None)
    if name is None:
        return None
    return np.ascontiguousarray(records[name]).view(np.uint8).reshape(-1, 4)[:, 2::-1].copy()


def read_ply(path: Path) -> Cloud:
    """Read the vertices of an ASCII or binary PLY file; other elements and lists are skipped.

    Returns:
        (H, W, 3) if `obj_info` gives the shape, NaN for pixels that an element `range_grid` leaves out, else (N, 3); with
        colours of red, green and blue of uchar.

    Raises:
        FileError: If the header is incomplete, there is no x, y, z, or the data is truncated.
        OSError: If the file cannot be read.
    """
    content = read_bytes(path, SIZE_LIMIT)
    if not content.startswith(b"ply"):
        raise FileError(path, "does not start with ply", field="header")
    end = _PLY_END.search(content, 0, _HEADER_LIMIT)
    if end is None:
        raise FileError(path, "no line end_header: truncated", field="header")
    encoding, elements, shape = _ply_header(path, content[: end.start()].decode("ascii", errors="replace"))
    if encoding not in _ORDERS:
        raise FileError(path, f"{encoding or 'nothing'} is not one of {', '.join(_ORDERS)}", field="format")
    if "vertex" not in elements:
        raise FileError(path, "element vertex is missing", field="header")
    vertex, grid = elements["vertex"], elements.get("range_grid")
    columns, rows = shape.get("num_cols", vertex.count), shape.get("num_rows", 1)
    if grid is not None and grid.count != columns * rows:
        grid = None
    last = max(list(elements).index(element.name) for element in (vertex, grid) if element)
    needed = list(elements.values())[: last + 1]
    numbers = [(part.name, part.kind) for part in vertex.properties if not part.counted]
    _point_dtype(path, numbers, "property")
    body, text = content[end.end() :], encoding == "ascii"
    data = _PlyData(path, _ply_numbers(path, body, needed) if text else body, None if text else _ORDERS[encoding])
    contents = {element.name: data.read(element) for element in needed}
    records = contents["vertex"][0]
    rgb = None
    if {(name, "u1") for name in _COLOURS} <= set(numbers):
        with np.errstate(invalid="ignore"):
            rgb = np.stack([records[name].astype(np.uint8) for name in _COLOURS], axis=-1)
    if grid is not None:
        return _on_grid(path, _to_cloud(records, rgb, 1, vertex.count), contents["range_grid"][1], (rows, columns, 3))
    organised = columns * rows == vertex.count  # otherwise points were removed since
    return _to_cloud(records, rgb, *((rows, columns) if organised else (1, vertex.count)))


def ply_bytes(cloud: Cloud) -> bytes:
    """Return the content of a binary PLY file: x, y, z as float, and red, green, blue as uchar."""
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
    return "\n".join([*lines, "end_header", ""]).encode("ascii") + records.tobytes()


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str  # of a number, in NumPy's letters
    counted: str = ""  # kind of the count before a list; "" for a single number


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def _ply_header(path: Path, text: str) -> tuple[str, dict[str, _Element], dict[str, int]]:
    """Return the format, the elements by name in order, and the shape of the image."""
    encoding = ""
    elements: dict[str, _Element] = {}
    shape: dict[str, int] = {}
    own: list[_Property] = []
    for line in text.splitlines():
        match words := line.split():
            case ["format", encoding, *_]:
                pass
            case ["obj_info", ("num_cols" | "num_rows") as name, count]:
                shape[name] = _whole_number(path, count, name)
            case ["element", name, count]:
                if name in elements:
                    raise FileError(path, f"{name} occurs twice", field="element")
                own = []
                elements[name] = _Element(name, _whole_number(path, count, f"element {name}"), own)
            case ["property", "list", counted, kind, name] if counted in _NAMES and kind in _NAMES:
                own.append(_Property(name, _NAMES[kind], _NAMES[counted]))
            case ["property", kind, name] if kind in _NAMES:
                own.append(_Property(name, _NAMES[kind]))
            case ["property", *_]:
                raise FileError(path, f"{' '.join(words[1:])}: is neither a number nor a list", field="property")
    return encoding, elements, shape


def _ply_numbers(path: Path, body: bytes, needed: Sequence[_Element]) -> bytes:
    """Return the numbers of a text as float64: lines have no meaning in PLY."""
    expected = sum(
        element.count * len(element.properties) for element in needed
    )  # of which lists may be empty, of one number
    if 2 * expected > len(body) + 1:
        raise FileError(path, f"{len(body)} bytes are fewer than {expected} numbers", field="vertex")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # NumPy 1 warns where NumPy 2 raises
            numbers = np.fromstring(body, np.float64, sep=" ") if body.strip() else np.empty(0)
    except (ValueError, DeprecationWarning) as err:
        raise FileError(path, "holds a word between its numbers", field="vertex") from err
    if len(numbers) < expected:
        raise FileError(path, f"{len(numbers)} numbers are fewer than {expected}: truncated", field="vertex")
    return numbers.tobytes()


class _PlyData:
    """The elements of a PLY file in order; without an `order` of bytes, all numbers are float64."""

    def __init__(self, path: Path, body: bytes, order: str | None) -> None:
        self._path = path
        self._body = body
        self._order = order
        self._start = 0

    def read(self, element: _Element) -> tuple[_Records, list[int]]:
        """Return the (count,) records of single numbers, and the first entry of the first list of each, -1 of an empty one."""
        single = np.dtype([(part.name, self._dtype(part.kind)) for part in element.properties if not part.counted])
        if not any(part.counted for part in element.properties):
            size = element.count if single.itemsize else 0
            return self._numbers(element, single, size), []
        parts: list[AnyArray] = []
        firsts: list[int] = []
        for _ in range(element.count):
            lists: list[AnyArray] = []
            for part in element.properties:
                size = 1
                if part.counted:
                    (number,) = self._numbers(element, self._dtype(part.counted), 1).tolist()
                    if not 0 <= number < 2**31:
                        raise FileError(self._path, f"a list of {number} entries", field=part.name)
                    size = int(number)
                values = self._numbers(element, self._dtype(part.kind), size)
                (lists if part.counted else parts).append(values)
            firsts.append(int(lists[0][0]) if lists[0].size and abs(lists[0][0]) < 2**31 else -1)
        joined = b"".join(part.tobytes() for part in parts)
        return np.frombuffer(joined, single) if joined else np.empty(0, single), firsts

    def _dtype(self, kind: str) -> np.dtype[Any]:
        return np.dtype(np.float64 if self._order is None else self._order + kind)

    def _numbers(self, element: _Element, dtype: np.dtype[Any], count: int) -> AnyArray:
        size = count * dtype.itemsize
        if len(self._body) - self._start < size:
            raise FileError(self._path, f"the data ends within its {element.count}", field=f"element {element.name}")
        self._start += size
        return np.frombuffer(self._body, dtype, count, self._start - size) if size else np.empty(0, dtype)


def _on_grid(path: Path, cloud: Cloud, index: list[int], shape: tuple[int, int, int]) -> Cloud:
    """Return the image whose pixels are vertices by their number, -1 of a pixel without depth, as in Stanford's range scans."""
    place = np.array(index, np.int64)
    if place.max(initial=-1) >= cloud.size:
        raise FileError(path, f"there is no vertex {place.max()}, only {cloud.size}", field="range_grid")
    xyz = np.full((len(place), 3), np.nan, np.float32)
    xyz[place >= 0] = cloud.xyz[place[place >= 0]]
    rgb = None
    if cloud.rgb is not None:
        rgb = np.zeros((len(place), 3), np.uint8)
        rgb[place >= 0] = cloud.rgb[place[place >= 0]]
    return Cloud(xyz.reshape(shape), None if rgb is None else rgb.reshape(shape))


def _whole_number(path: Path, text: str, field: str) -> int:
    """Return a number of a header; a `FileError` if it is not a whole number below 2^31."""
    if not text.isdecimal():
        raise FileError(path, f"{shown(text)!r} is not a whole number", field=field)
    digits = text.lstrip("0") or "0"
    if len(digits) > 10 or int(digits) >= 2**31:
        raise FileError(path, f"{shown(text, 40)} is not below 2^31", field=field)
    return int(digits)


def check_unpacked(path: Path, unpacked: int, size: int, field: str) -> None:
    """Refuse data that unpack to more than ten times the `size` of their file, and more than 32 MB [bytes].

    Args:
        path: The file.
        unpacked: Size of its unpacked data [bytes].
        size: Size of the file [bytes].
        field: What the data are, for the message.
    """
    limit = max(32_000_000, 10 * size)  # an image of 1280 x 720 points in double has 22 million bytes
    if unpacked > limit:
        raise FileError(path, f"unpacks to {unpacked} bytes, more than {limit} for a file of {size}", field=field)


def _point_dtype(path: Path, parts: Sequence[tuple[Any, ...]], field: str) -> np.dtype[Any]:
    """Return the type of a point from name, kind and perhaps shape of its parts; a `FileError` without parts, or without x, y, z."""
    try:
        dtype = np.dtype(list(parts))
    except (ValueError, TypeError) as err:
        raise FileError(path, f"is not a list of numbers: {err}", field=field) from err
    for axis in "xyz":
        if axis not in (dtype.names or ()):
            raise FileError(path, f"{axis} is missing; there are: {' '.join(dtype.names or ())}", field=field)
        if dtype[axis].kind != "f" or dtype[axis].shape:
            raise FileError(path, "is not one floating number", field=axis)
    return dtype


def _records(path: Path, body: bytes, dtype: np.dtype[Any], points: int, field: str, *, text: bool) -> _Records:
    """Return the first records of some bytes, or of a text with a line for each; a `FileError` if there are fewer."""
    width = sum(int(np.prod(dtype[name].shape)) for name in dtype.names or ())
    expected = points * (2 * width if text else dtype.itemsize)
    if len(body) + text < expected or (text and points and not body.strip()):
        what = f"lines of {width} numbers" if text else f"points of {dtype.itemsize} = {expected}"
        raise FileError(path, f"{len(body)} bytes are fewer than {points} {what}", field=field)
    if not text:
        return np.frombuffer(body, dtype, points)
    if _LONG_LINE.search(body):
        raise FileError(path, "holds a line of more than 65535 characters", field=field)
    if not points:
        return np.zeros(0, dtype)
    try:
        table = np.loadtxt(io.BytesIO(body), ndmin=2, max_rows=points + 1, comments=None)
    except ValueError as err:
        raise FileError(path, f"not a table of numbers: {shown(str(err))}", field=field) from err
    if table.shape != (points, width):
        raise FileError(path, f"{len(table)} lines of numbers are not {points} points of {width}", field=field)
    with np.errstate(invalid="ignore", over="ignore"):
        return unstructured_to_structured(table, dtype, casting="unsafe")


def _to_cloud(records: _Records, rgb: UInt8 | None, height: int, width: int) -> Cloud:
    """Return the fields x, y, z and colours (N, 3), as an image if it has several rows."""
    shape = (height, width, 3) if height > 1 and width else (len(records), 3)
    with np.errstate(over="ignore"):
        xyz = np.stack([records[name].astype(np.float32) for name in "xyz"], axis=-1)
    return Cloud(xyz.reshape(shape), None if rgb is None else rgb.reshape(shape))
