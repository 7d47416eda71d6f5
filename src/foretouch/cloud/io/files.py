# SPDX-License-Identifier: Apache-2.0
"""Clouds in files: `.pcd`, `.ply`, `.npz` and `.npy`, by their ending.

Nothing is read that could run code: NumPy files are opened without pickle. Archives are unpacked here, since `numpy.load`
does not limit what their members unpack to.
"""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.depth_files import IMAGE_SUFFIXES, DepthCamera
from foretouch.cloud.io.mask_files import read_image
from foretouch.cloud.io.point_files import SIZE_LIMIT, check_unpacked, read_pcd, read_ply, write_pcd, write_ply
from foretouch.errors import CloudError, FileError, described, shown
from foretouch.files import read_bytes, system_errors
from foretouch.types import AnyArray, Cloud, Float32

_OPTIONAL: Final = ("rgb", "frame_id", "stamp_ns")
_PER_METRE: Final = {"depth": None, "depth_mm": 1000.0, "depth_m": 1.0}
"""Names of depth images in archives, with their units per metre; `depth` is of the unit that `DepthCamera` says."""

_DEPTH_FACTS: Final = ("K", "intrinsics", "intrinsic_matrix", "camera_matrix", "D", "depth_scale", "factor_depth")
_POINT_WIDTH: Final = 8  # numbers of a point in a table
_FRAME_LIMIT: Final = 256  # characters of a frame's name
_NPY_HEADER_LIMIT: Final = 2000  # bytes; Python parses deeper brackets than that for seconds
_PICKLED: Final = (
    "holds a pickled object of Python, which is not read, since it could run code; if you trust it, convert it once: "
    "python -c \"import numpy as np; np.savez('{1}.npz', **np.load('{0}', allow_pickle=True).item())\""
)
_DAMAGE: Final = (
    *(ValueError, SyntaxError, TypeError, KeyError, IndexError, EOFError, OverflowError, RuntimeError, OSError),
    *(MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)  # the parsers below NumPy raise any of these on damaged bytes


def read_cloud(path: str | Path, camera: DepthCamera | None = None) -> Cloud:
    """Read a cloud, or the depth image of a camera as a cloud.

    Args:
        path: `.pcd` (ascii, binary, binary_compressed), `.ply`, `.npz` (`xyz`, and optionally `rgb`, `frame_id`,
            `stamp_ns`) or `.npy`. Coordinates are numbers [m]. Depth images: `.png`, `.tif`, `.npy` of (H, W), and `.npz`
            with `depth` and perhaps `K` and `depth_scale`.
        camera: Of depth images that do not state it.

    Returns:
        The cloud, organised if it is in the file. Points at (0, 0, 0) are NaN, as all without depth.

    Raises:
        FileError: With the file, the field and the rule; also if the file cannot be read or is truncated.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (*_READERS, ".npz", ".npy", *IMAGE_SUFFIXES):
        raise FileError(path, f"the extension is not one of {', '.join((*CLOUD_SUFFIXES, *IMAGE_SUFFIXES))}")
    try:
        with system_errors(path):
            cloud = (
                _READERS[suffix](path) if suffix in _READERS else _read_numbers(path, suffix, camera or DepthCamera())
            )
    except CloudError as err:
        raise FileError(path, str(err)) from err
    x, y, z = np.moveaxis(cloud.xyz, -1, 0)
    at_sensor = (x == 0.0) & (y == 0.0) & (z == 0.0)
    if not at_sensor.any():
        return cloud
    return replace(cloud, xyz=np.where(at_sensor[..., None], np.float32(np.nan), cloud.xyz))


def write_cloud(path: str | Path, cloud: Cloud) -> None:
    """Write a cloud; an existing file is replaced.

    Args:
        path: `.pcd` or `.ply` (binary), `.npz` (with frame and stamp) or `.npy` (xyz only).
        cloud: Organised clouds are read back organised.

    Raises:
        FileError: If the extension is another, or the file cannot be written.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise FileError(path, f"the extension is not one of {', '.join(CLOUD_SUFFIXES)}")
    with system_errors(path):
        writer(path, cloud)


def read_arrays(path: Path, required: Collection[str], optional: Collection[str] | None = None) -> dict[str, AnyArray]:
    """Return some arrays of an `.npz` archive by name, or all; a `FileError` if it is damaged or a required one is missing."""
    content = read_bytes(path, SIZE_LIMIT)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
            for name in required:
                if name not in members:
                    raise FileError(path, f"is missing; there are: {', '.join(members) or 'none'}", field=name)
            return {
                name: _array(path, _unpacked(path, archive, member, len(content)), name)
                for name, member in members.items()
                if optional is None or name in required or name in optional
            }
    except _DAMAGE as err:
        raise FileError(path, f"is damaged or no .npz archive: {' '.join(str(err).split())}") from err


def _read_numbers(path: Path, suffix: str, camera: DepthCamera) -> Cloud:
    """Return the cloud in an image or a file of NumPy, whose points are x, y, z or the depth of pixels."""
    if suffix in IMAGE_SUFFIXES:
        return camera.cloud(path, read_image(path, "depth"))
    if suffix == ".npy":
        array = _array(path, read_bytes(path, SIZE_LIMIT))
        depth = array.ndim in (2, 3) and array.shape[1] > _POINT_WIDTH and array.shape[-1] != 3  # else a list of points
        return camera.cloud(path, array) if depth else Cloud(_coordinates(path, array))
    arrays: dict[str, Any] = read_arrays(path, (), ("xyz", *_OPTIONAL, *_PER_METRE, *_DEPTH_FACTS))
    name = next((name for name in _PER_METRE if name in arrays), None)
    if name is not None and "xyz" not in arrays:
        if (per_metre := _PER_METRE[name]) is not None:
            arrays.setdefault("factor_depth", per_metre)
        return camera.cloud(path, arrays[name], arrays)
    return archived_cloud(path, read_arrays(path, ["xyz"], _OPTIONAL))


def archived_cloud(path: Path, arrays: Mapping[str, AnyArray]) -> Cloud:
    """Return the cloud in the arrays xyz, rgb, frame_id and stamp_ns of an archive; a `FileError` if one is not such an array."""
    frame_id, stamp = arrays.get("frame_id", np.array("")), arrays.get("stamp_ns", np.array(0))
    if frame_id.shape or frame_id.dtype.kind != "U" or frame_id.dtype.itemsize > 4 * _FRAME_LIMIT:
        raise FileError(path, f"is not one text of at most {_FRAME_LIMIT} characters", field="frame_id")
    if stamp.shape or stamp.dtype.kind not in "iu" or int(stamp) >= 2**63:
        raise FileError(path, "is not one whole number below 2^63", field="stamp_ns")
    try:
        frame = str(frame_id)
        frame.encode()
    except ValueError as err:  # UTF-32 may hold code points that Unicode does not have
        raise FileError(path, f"is not text: {err}", field="frame_id") from err
    return Cloud(_coordinates(path, arrays["xyz"]), arrays.get("rgb"), frame, int(stamp))


def _unpacked(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> bytes:
    check_unpacked(path, member.file_size, size, member.filename)
    with archive.open(member) as file:
        return file.read(member.file_size)  # without a limit, it would unpack everything and then cut it off


def _array(path: Path, content: bytes, field: str | None = None) -> AnyArray:
    formats, stream = np.lib.format, io.BytesIO(content)
    try:
        first = formats.read_magic(stream) == (1, 0)
        read_header = formats.read_array_header_1_0 if first else formats.read_array_header_2_0
        shape, _, dtype = read_header(stream, _NPY_HEADER_LIMIT)
        if dtype.hasobject and field is None:
            raise FileError(path, _PICKLED.format(path.name, path.stem))
        if math.prod(shape) * dtype.itemsize > len(content):  # NumPy would take the memory first
            raise ValueError(f"shape {shown(shape)} of {dtype} needs more bytes than there are")
        stream.seek(0)
        array: AnyArray = formats.read_array(stream, allow_pickle=False, max_header_size=_NPY_HEADER_LIMIT)
    except _DAMAGE as err:
        raise FileError(path, f"is damaged or contains objects: {described(err)}", field=field) from err
    return array


def _coordinates(path: Path, xyz: AnyArray) -> Float32:
    if xyz.dtype.kind != "f":
        rule = f"dtype {xyz.dtype} is not a floating-point type; a depth image has the shape (H, W), this {xyz.shape}"
        raise FileError(path, rule, field="xyz")
    with np.errstate(over="ignore"):
        return xyz.astype(np.float32)


def _write_npz(path: Path, cloud: Cloud) -> None:
    arrays: dict[str, AnyArray] = {
        "xyz": cloud.xyz,
        "frame_id": np.array(cloud.frame_id),
        "stamp_ns": np.array(cloud.stamp_ns, np.int64),
    }
    if cloud.rgb is not None:
        arrays["rgb"] = cloud.rgb
    with path.open("wb") as file:  # given a path, NumPy would append its own extension to .NPZ
        np.savez(file, allow_pickle=False, **arrays)


def _write_npy(path: Path, cloud: Cloud) -> None:
    with path.open("wb") as file:
        np.save(file, cloud.xyz, allow_pickle=False)


_READERS = {".pcd": read_pcd, ".ply": read_ply}
_WRITERS = {".pcd": write_pcd, ".ply": write_ply, ".npz": _write_npz, ".npy": _write_npy}
CLOUD_SUFFIXES = tuple(_WRITERS)
