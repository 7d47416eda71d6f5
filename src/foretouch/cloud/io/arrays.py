# SPDX-License-Identifier: Apache-2.0
"""Read files of NumPy, `.npy` and `.npz`, without pickle and without trust in what they say of their size.

Archives are unpacked here, since `numpy.load` does not limit what their members unpack to, and takes the memory that a
header asks for.
"""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.base.files import read_bytes
from foretouch.cloud.io.point_files import SIZE_LIMIT, check_unpacked
from foretouch.errors import FileError, described, shown
from foretouch.types import AnyArray

_HEADER_LIMIT: Final = 2000  # bytes; Python parses deeper brackets than that for seconds
_PICKLED: Final = (
    "holds a pickled object of Python, which is not read, since it could run code; if you trust it, convert it once: "
    "python -c \"import numpy as np; np.savez('{1}.npz', **np.load('{0}', allow_pickle=True).item())\""
)
_ENCRYPTED: Final = 1  # flag of a member of an archive
_DAMAGE: Final = (
    *(ValueError, SyntaxError, TypeError, KeyError, IndexError, EOFError, OverflowError, RuntimeError, OSError),
    *(MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)  # the parsers below NumPy raise any of these on damaged bytes


def read_array(path: Path) -> AnyArray:
    """Return the array of a `.npy` file; a `FileError` if it is damaged, or holds objects of Python."""
    return _array(path, read_bytes(path, SIZE_LIMIT))


def read_arrays(path: Path, required: Collection[str], optional: Collection[str] | None = None) -> dict[str, AnyArray]:
    """Return some arrays of an `.npz` archive by name, or all; a `FileError` if it is damaged or a required one is missing."""
    content = read_bytes(path, SIZE_LIMIT)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
            for name in required:
                if name not in members:
                    raise FileError(path, f"is missing; there are: {', '.join(members) or 'none'}", field=name)
            locked = next((name for name, member in members.items() if member.flag_bits & _ENCRYPTED), None)
            if locked is not None:
                raise FileError(path, "is encrypted: save it again without a password", field=locked)
            wanted = [name for name in members if optional is None or name in required or name in optional]
            for name in wanted:
                check_unpacked(path, members[name].file_size, len(content), members[name].filename)
            check_unpacked(path, sum(members[name].file_size for name in wanted), len(content), ", ".join(wanted))
            return {name: _array(path, _unpacked(archive, members[name]), name) for name in wanted}
    except _DAMAGE as err:
        raise FileError(path, f"is damaged or no .npz archive: {' '.join(str(err).split())}") from err


def array_names(path: Path) -> list[str]:
    """Return the names of the arrays in an `.npz` archive; a `FileError` if it is damaged."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path, SIZE_LIMIT))) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except _DAMAGE as err:
        raise FileError(path, f"is damaged or no .npz archive: {' '.join(str(err).split())}") from err


def _unpacked(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    with archive.open(member) as file:
        return file.read(member.file_size)  # without a limit, it would unpack everything and then cut it off


def _array(path: Path, content: bytes, field: str | None = None) -> AnyArray:
    formats, stream = np.lib.format, io.BytesIO(content)
    if content and not content.startswith(formats.MAGIC_PREFIX):  # NumPy prints what is there instead
        raise FileError(path, "is no .npy array: it does not begin as one", field=field)
    try:
        first = formats.read_magic(stream) == (1, 0)
        read_header = formats.read_array_header_1_0 if first else formats.read_array_header_2_0
        shape, _, dtype = read_header(stream, _HEADER_LIMIT)
        if dtype.hasobject and field is None:
            raise FileError(path, _PICKLED.format(path.name, path.stem))
        if math.prod(shape) * dtype.itemsize > len(content):  # NumPy would take the memory first
            raise ValueError(f"shape {shown(shape)} of {dtype} needs more bytes than there are")
        stream.seek(0)
        array: AnyArray = formats.read_array(stream, allow_pickle=False, max_header_size=_HEADER_LIMIT)
    except _DAMAGE as err:
        raise FileError(path, f"is damaged or contains objects: {described(err)}", field=field) from err
    return array
