# SPDX-License-Identifier: Apache-2.0
"""Clouds in files: `.pcd`, `.ply`, `.npz` and `.npy`, by their ending.

Depth images of a camera are read as clouds, too: `.png`, `.tif`, and arrays of NumPy.
"""

import io
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import as_path, replace_files, system_errors
from foretouch.cloud.io.arrays import array_names, read_array, read_arrays
from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.cloud.io.images import IMAGE_SUFFIXES, read_image
from foretouch.cloud.io.point_files import pcd_bytes, ply_bytes, read_pcd, read_ply
from foretouch.errors import CloudError, FileError, checked
from foretouch.types import AnyArray, Cloud, Float32

_OPTIONAL: Final = ("rgb", "frame_id", "stamp_ns")
_PER_METRE: Final = {"depth": None, "depth_mm": 1000.0, "depth_m": 1.0}
"""Names of depth images in archives, with their units per metre; `depth` is of the unit that `DepthCamera` says."""

_DEPTH_FACTS: Final = (
    "color",
    "K",
    "intrinsics",
    "intrinsic_matrix",
    "camera_matrix",
    "D",
    "depth_scale",
    "factor_depth",
)
_POINT_WIDTH: Final = 8  # numbers of a point in a table
_FRAME_LIMIT: Final = 256  # characters of a frame's name


@checked
def read_cloud(path: str | Path, camera: DepthCamera | None = None, *, color: str | Path | None = None) -> Cloud:
    """Read a cloud, or the depth image of a camera as a cloud.

    Args:
        path: `.pcd` (ascii, binary, binary_compressed), `.ply`, `.npz` (`xyz`, and optionally `rgb`, `frame_id`,
            `stamp_ns`) or `.npy`. Coordinates are numbers [m]. Depth images: `.png`, `.tif`, `.npy` of (H, W), and `.npz`
            with `depth` and perhaps `K`, `depth_scale` and `color`.
        camera: Of depth images that do not state it.
        color: File with the colours of the pixels of a depth image: `.png` or `.jpg` with 8 bits a colour, or `.npy` with
            (H, W, 3) uint8. They become `rgb` of the cloud.

    Returns:
        The cloud, organised if it is in the file. Points at (0, 0, 0) are NaN, as all without depth.

    Raises:
        FileError: With the file, the field and the rule; also if the file cannot be read or is truncated.
    """
    path = as_path(path)
    if not isinstance(camera, DepthCamera | None):
        raise CloudError(
            f"camera: {type(camera).__name__} is not a DepthCamera; Cloud.from_depth(depth, K) takes a matrix"
        )
    if color is not None:
        camera = replace(camera or DepthCamera(), color=as_path(color))
    suffix = path.suffix.lower()
    if suffix not in (*_READERS, ".npz", ".npy", *IMAGE_SUFFIXES):
        raise FileError(path, f"the extension is not one of {', '.join((*CLOUD_SUFFIXES, *IMAGE_SUFFIXES))}")
    try:
        with system_errors(path):
            cloud = _read(path, suffix, camera or DepthCamera())
    except CloudError as err:
        raise FileError(path, str(err)) from err
    x, y, z = np.moveaxis(cloud.xyz, -1, 0)
    at_sensor = (x == 0.0) & (y == 0.0) & (z == 0.0)
    if not at_sensor.any():
        return cloud
    return replace(cloud, xyz=np.where(at_sensor[..., None], np.float32(np.nan), cloud.xyz))


@checked
def write_cloud(path: str | Path, cloud: Cloud) -> None:
    """Write a cloud; an existing file is replaced.

    Args:
        path: `.pcd` or `.ply` (binary), `.npz` (with frame and stamp) or `.npy` (xyz only).
        cloud: Organised clouds are read back organised.

    Raises:
        FileError: If the extension is another, or the file cannot be written.
    """
    path = as_path(path)
    if not isinstance(cloud, Cloud):
        raise CloudError(f"cloud: {type(cloud).__name__} is not a Cloud, such as Cloud(xyz)")
    content = _CONTENTS.get(path.suffix.lower())
    if content is None:
        raise FileError(path, f"the extension is not one of {', '.join(CLOUD_SUFFIXES)}")
    with system_errors(path):
        path.parent.stat()  # a misspelled folder is not made
    replace_files({path: content(cloud)})


def _read(path: Path, suffix: str, camera: DepthCamera) -> Cloud:
    """Return the cloud in a file, of points or of a depth image; a `FileError` if a camera is given for points."""
    if suffix in IMAGE_SUFFIXES:
        return camera.cloud(path, read_image(path, "depth"))
    if suffix == ".npz":
        arrays: dict[str, Any] = read_arrays(path, (), ("xyz", *_OPTIONAL, *_PER_METRE, *_DEPTH_FACTS))
        name = next((name for name in _PER_METRE if name in arrays), None)
        if name is not None and "xyz" not in arrays:
            if (per_metre := _PER_METRE[name]) is not None:
                arrays.setdefault("factor_depth", per_metre)
            return camera.cloud(path, arrays[name], arrays)
    if suffix == ".npy":
        array = read_array(path)
        if array.ndim in (2, 3) and array.shape[1] > _POINT_WIDTH and array.shape[-1] != 3:  # else a list of points
            return camera.cloud(path, array)
    camera.require_none(path, "holds points")
    if suffix in _READERS:
        return _READERS[suffix](path)
    if suffix == ".npy":
        return Cloud(_coordinates(path, array))
    return archived_cloud(path, read_arrays(path, ["xyz"], _OPTIONAL))


def holds_points(path: Path) -> bool:
    """Return whether a file holds points by its ending or the names in it; of a `.npy`, reading shows."""
    suffix = path.suffix.lower()
    return suffix in _READERS or (
        suffix == ".npz" and ("xyz" in (names := {*array_names(path)}) or not names & _PER_METRE.keys())
    )


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


def _coordinates(path: Path, xyz: AnyArray) -> Float32:
    if xyz.dtype.kind != "f":
        rule = f"dtype {xyz.dtype} is not a floating-point type; a depth image has the shape (H, W), this {xyz.shape}"
        raise FileError(path, rule, field="xyz")
    with np.errstate(over="ignore"):
        return xyz.astype(np.float32)


def _npz_bytes(cloud: Cloud) -> bytes:
    arrays: dict[str, AnyArray] = {
        "xyz": cloud.xyz,
        "frame_id": np.array(cloud.frame_id),
        "stamp_ns": np.array(cloud.stamp_ns, np.int64),
    }
    if cloud.rgb is not None:
        arrays["rgb"] = cloud.rgb
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    return content.getvalue()


def npy_bytes(array: AnyArray) -> bytes:
    """Return the content of a `.npy` file."""
    content = io.BytesIO()
    np.save(content, array, allow_pickle=False)
    return content.getvalue()


_READERS = {".pcd": read_pcd, ".ply": read_ply}
_CONTENTS: dict[str, Callable[[Cloud], bytes]] = {
    ".pcd": pcd_bytes,
    ".ply": ply_bytes,
    ".npz": _npz_bytes,
    ".npy": lambda cloud: npy_bytes(cloud.xyz),
}
CLOUD_SUFFIXES = tuple(_CONTENTS)
