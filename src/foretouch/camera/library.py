# SPDX-License-Identifier: Apache-2.0
"""The only import of pyrealsense2, after what it depends on."""

from __future__ import annotations

import contextlib
import functools
from typing import Any

from foretouch.errors import MissingDependencyError
from foretouch.libusb import ensure_libusb

__all__ = ["realsense"]


@functools.cache
def realsense() -> Any:
    """The module `pyrealsense2`, safe to use beside ROS.

    pyrealsense2 2.56 and later crashes the process at exit (a segmentation fault) when `rclpy` is
    imported after it. So `rclpy`, where it is installed, is always imported first.

    Raises:
        MissingDependencyError: If pyrealsense2 or libusb is missing.
    """
    with contextlib.suppress(ImportError):
        import rclpy  # noqa: F401
    ensure_libusb()
    try:
        import pyrealsense2
    except ImportError as err:
        raise MissingDependencyError(f"pyrealsense2: {err}: pip install 'foretouch[camera]'") from err
    return pyrealsense2
