# SPDX-License-Identifier: Apache-2.0
"""What PCD and PLY files share: records of numbers, whose declared size is compared with the file before memory is taken.

Both are decoded here. The libraries for them take the memory that a header asks for (plyfile, which is GPL besides),
return fewer points of a truncated file (pypcd4), or fill up with zeros and warn (Open3D).
"""

import re
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import FileError, shown
from foretouch.types import AnyArray, Cloud, UInt8

Records = AnyArray  # (N,) of a structured dtype

SIZE_LIMIT: Final = 2_000_000_000  # of a file with a cloud [bytes]
_TEXT_BLOCK: Final = 65536  # characters that are parsed at once
_SPACE: Final = re.compile(rb"\s")
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


def unique_names(path: Path, names: list[str], field: str) -> None:
    """Refuse a name that occurs twice, and a point without x, y or z."""
    if len(set(names)) != len(names):
        raise FileError(path, f"{' '.join(names)}: a name occurs twice", field=field)
    for axis in "xyz":
        if axis not in names:
            raise FileError(path, f"{axis} is missing; there are: {' '.join(names)}", field=field)


def binary_records(path: Path, body: bytes, dtype: np.dtype[Any], points: int, field: str) -> Records:
    """The first records of some bytes; a `FileError` if there are fewer."""
    expected = points * dtype.itemsize
    if len(body) < expected:
        rule = f"{len(body)} bytes are fewer than {points} points of {dtype.itemsize} = {expected}"
        raise FileError(path, rule, field=field)
    return np.frombuffer(body, dtype, points)


def ascii_records(path: Path, body: bytes, dtype: np.dtype[Any], points: int, field: str, *, alone: bool) -> Records:
    """Records of numbers in text, and nothing else if `alone`; a `FileError` if they are fewer, or none are numbers."""
    kinds = {name: dtype[name] for name in dtype.names or ()}
    widths = [int(np.prod(kind.shape)) for kind in kinds.values()]
    size = points * sum(widths)
    table = np.empty(min(size, len(body) // 2 + 1))
    filled, at = 0, 0
    while at < len(body) and (filled < size or alone):
        found = _SPACE.search(body, at + _TEXT_BLOCK, at + 2 * _TEXT_BLOCK)
        end = found.end() if found else min(at + 2 * _TEXT_BLOCK, len(body))
        if not found and end < len(body):
            raise FileError(path, f"not a number: a word of more than {_TEXT_BLOCK} characters", field=field)
        words = body[at:end].split()
        part = table[filled : filled + len(words)]
        filled, at = filled + len(words), end
        try:
            part[:] = np.array(words[: len(part)], np.float64)
        except ValueError as err:
            raise FileError(path, f"not a number: {shown(str(err))}", field=field) from err
    if filled < size or (alone and filled > size):
        raise FileError(path, f"{filled} numbers are not {points} points of {sum(widths)} = {size}", field=field)
    records = np.zeros(points, dtype)
    with np.errstate(invalid="ignore", over="ignore"):
        for name, columns in zip(
            kinds, np.split(table[:size].reshape(points, sum(widths)), np.cumsum(widths)[:-1], axis=1), strict=True
        ):
            records[name] = columns.reshape(records[name].shape)
    return records


def to_cloud(records: Records, rgb: UInt8 | None, height: int, width: int) -> Cloud:
    """The fields x, y, z and colours (N, 3), as an image if it has several rows."""
    shape = (height, width, 3) if height > 1 and width else (len(records), 3)
    with np.errstate(over="ignore"):
        xyz = np.stack([records[name].astype(np.float32) for name in "xyz"], axis=-1)
    return Cloud(xyz.reshape(shape), None if rgb is None else rgb.reshape(shape))
