# SPDX-License-Identifier: Apache-2.0
"""What PCD and PLY files share: records of numbers, whose declared size is compared with the file before memory is taken.

Both are decoded here. The libraries for them take the memory that a header asks for (plyfile, which is GPL besides),
return fewer points of a truncated file (pypcd4), or fill up with zeros and warn (Open3D).
"""

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured

from foretouch.errors import FileError, shown
from foretouch.types import AnyArray, Cloud, UInt8

Records = AnyArray  # (N,) of a structured dtype

SIZE_LIMIT: Final = 1_000_000_000  # of a file with a cloud [bytes]
_LONG_LINE: Final = re.compile(rb"[^\n]{65535}")
HEADER_LIMIT: Final = 65536  # bytes within which a header must end


def whole_number(path: Path, text: str, field: str) -> int:
    """A number of a header; a `FileError` if it is not a whole number below 2^31."""
    if not text.isdecimal():
        raise FileError(path, f"{shown(text)!r} is not a whole number", field=field)
    digits = text.lstrip("0") or "0"
    if len(digits) > 10 or int(digits) >= 2**31:
        raise FileError(path, f"{shown(text, 40)} is not below 2^31", field=field)
    return int(digits)


def check_unpacked(path: Path, unpacked: int, size: int, field: str) -> None:
    """Refuse data that unpack to more than ten times the `size` of their file, and more than 32 MB [bytes]."""
    limit = max(32_000_000, 10 * size)  # an image of 1280 x 720 points in double has 22 million bytes
    if unpacked > limit:
        raise FileError(path, f"unpacks to {unpacked} bytes, more than {limit} for a file of {size}", field=field)


def point_dtype(path: Path, parts: Sequence[tuple[Any, ...]], field: str) -> np.dtype[Any]:
    """The type of a point from name, kind and perhaps shape of its parts; a `FileError` if there is none, or no x, y, z."""
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


def binary_records(path: Path, body: bytes, dtype: np.dtype[Any], points: int, field: str) -> Records:
    """The first records of some bytes; a `FileError` if there are fewer."""
    expected = points * dtype.itemsize
    if len(body) < expected:
        rule = f"{len(body)} bytes are fewer than {points} points of {dtype.itemsize} = {expected}"
        raise FileError(path, rule, field=field)
    return np.frombuffer(body, dtype, points)


def ascii_records(path: Path, body: bytes, dtype: np.dtype[Any], points: int, field: str, *, alone: bool) -> Records:
    """Records of numbers in text, a line each, and nothing else if `alone`; a `FileError` if they are fewer, or not numbers."""
    width = sum(int(np.prod(dtype[name].shape)) for name in dtype.names or ())
    if 2 * points * width > len(body) + 1:
        raise FileError(path, f"{len(body)} bytes are fewer than {points} lines of {width} numbers", field=field)
    if points and not body.strip():
        raise FileError(path, "holds no numbers", field=field)
    if _LONG_LINE.search(body):
        raise FileError(path, "holds a line of more than 65535 characters", field=field)
    if not points:
        return np.zeros(0, dtype)
    try:
        table = np.loadtxt(io.BytesIO(body), ndmin=2, max_rows=points + alone, comments=None)
    except ValueError as err:
        raise FileError(path, f"not a table of numbers: {shown(str(err))}", field=field) from err
    if table.shape != (points, width):
        raise FileError(path, f"{len(table)} lines of numbers are not {points} points of {width}", field=field)
    with np.errstate(invalid="ignore", over="ignore"):
        return unstructured_to_structured(table, dtype, casting="unsafe")


def to_cloud(records: Records, rgb: UInt8 | None, height: int, width: int) -> Cloud:
    """The fields x, y, z and colours (N, 3), as an image if it has several rows."""
    shape = (height, width, 3) if height > 1 and width else (len(records), 3)
    with np.errstate(over="ignore"):
        xyz = np.stack([records[name].astype(np.float32) for name in "xyz"], axis=-1)
    return Cloud(xyz.reshape(shape), None if rgb is None else rgb.reshape(shape))
