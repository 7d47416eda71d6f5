# SPDX-License-Identifier: Apache-2.0
"""Files that Open3D decodes. It warns where a file is damaged; here that is an error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foretouch.errors import FileError
from foretouch.libusb import ensure_libusb
from foretouch.types import Cloud

__all__ = ["read_with_open3d"]


def read_with_open3d(path: Path, points: int, shape: tuple[int, ...]) -> Cloud:
    """Read a cloud and hold it against its header.

    Args:
        path: A file that Open3D knows by its ending.
        points: How many the header promises.
        shape: (N,) or (H, W), of the same number.

    Returns:
        The cloud; NaN is kept.

    Raises:
        FileError: If Open3D cannot read it, or finds another number of points.
        MissingDependencyError: If libusb, which Open3D needs, is absent.
    """
    if points == 0:
        return Cloud(np.empty((0, 3), np.float32))
    ensure_libusb()
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        try:
            read = open3d.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
        except RuntimeError as err:
            raise FileError(path, f"Open3D: {' '.join(str(err).split())}") from err
    xyz = np.asarray(read.points).astype(np.float32)
    if len(xyz) != points:
        raise FileError(path, f"holds {len(xyz)} points that can be read, the header promises {points}")
    rgb = None
    if read.has_colors():
        rgb = np.rint(np.asarray(read.colors) * 255.0).astype(np.uint8).reshape(*shape, 3)
    return Cloud(xyz.reshape(*shape, 3), rgb)
