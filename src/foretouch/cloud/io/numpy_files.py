# SPDX-License-Identifier: Apache-2.0
"""Arrays of `.npy` and `.npz` files, whose declared sizes are compared with the file before memory is taken.

`numpy.load` takes the memory that a header asks for, and passes on whatever the parsers below it raise.
"""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.checked_files import read_bytes
from foretouch.cloud.io.records import SIZE_LIMIT
from foretouch.errors import FileError

_UNPACKED: Final = 32_000_000  # bytes in any case; an image of 1280 x 720 points in double has 22 million
_UNPACKED_RATIO: Final = 10  # times the size of the file, beyond that
_HEADER_LIMIT: Final = 2000  # bytes; Python parses deeper brackets than that for seconds
_MAX_AXES: Final = 8
_DAMAGE: Final = (
    *(ValueError, SyntaxError, TypeError, KeyError, IndexError, EOFError, OverflowError, RuntimeError, OSError),
    *(MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)  # the parsers below NumPy raise any of these on damaged bytes


def read_array(path: Path) -> npt.NDArray[Any]:
    """The array of a `.npy` file; a `FileError` if the file is damaged, too short, or holds objects."""
    return _array(path, read_bytes(path, SIZE_LIMIT))


def read_archive(path: Path, names: Collection[str]) -> tuple[dict[str, npt.NDArray[Any]], list[str]]:
    """Arrays of a `.npz` archive.

    Args:
        path: The archive, stored or deflated.
        names: Of the arrays; absent ones are left out.

    Returns:
        The arrays by name, and the names of all arrays in the archive.

    Raises:
        FileError: If the archive is damaged or encrypted, an array is damaged, or unpacks to more than ten times the
            size of the file and 32 MB.
    """
    content = read_bytes(path, SIZE_LIMIT)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
            arrays = {
                name: _array(path, _unpacked(path, archive, members[name], len(content)), name)
                for name in names
                if name in members
            }
    except _DAMAGE as err:
        raise FileError(path, f"is damaged or no .npz archive: {' '.join(str(err).split())}") from err
    return arrays, list(members)


def check_unpacked(path: Path, unpacked: int, size: int, field: str) -> None:
    """Refuse data that unpack to more than ten times the `size` of their file, and more than 32 MB [bytes]."""
    limit = max(_UNPACKED, _UNPACKED_RATIO * size)
    if unpacked > limit:
        raise FileError(path, f"unpacks to {unpacked} bytes, more than {limit} for a file of {size}", field=field)


def _unpacked(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> bytes:
    if member.flag_bits & 1:
        raise FileError(path, "is encrypted", field=member.filename)
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FileError(path, f"compression {member.compress_type} is not deflate", field=member.filename)
    check_unpacked(path, member.file_size, size, member.filename)
    return archive.read(member)


def _array(path: Path, content: bytes, field: str | None = None) -> npt.NDArray[Any]:
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
            (3, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, by_columns, dtype = read_header(stream, _HEADER_LIMIT)
    except _DAMAGE as err:
        rule = f"is damaged or no .npy array: {type(err).__name__}: {' '.join(str(err).split())}"
        raise FileError(path, rule, field=field) from err
    if dtype.hasobject or dtype.itemsize == 0:
        raise FileError(path, f"is damaged or contains objects: dtype {dtype}", field=field)
    if len(shape) > _MAX_AXES or any(type(size) is not int or not 0 <= size < 2**31 for size in shape):
        raise FileError(path, f"shape {shape} is none of an array", field=field)
    count, body = math.prod(shape), stream.read()
    if count * dtype.itemsize > len(body):
        rule = f"shape {shape} of {dtype} needs {count * dtype.itemsize} bytes, {len(body)} follow"
        raise FileError(path, rule, field=field)
    flat = np.frombuffer(body, dtype, count)
    return (flat.reshape(shape[::-1]).T if by_columns else flat.reshape(shape)).copy("K")
