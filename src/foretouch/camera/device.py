# SPDX-License-Identifier: Apache-2.0
"""Sources of a device: the USB bus, a recording, or a program that feeds the library's software device."""

import contextlib
import functools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foretouch.camera.config import RealSenseConfig
from foretouch.errors import CameraError, FileError, MissingDependencyError


@functools.cache
def ensure_libusb() -> Any:
    """Load libusb from the system or else from the wheel; a `MissingDependencyError` if neither has it.

    The wheels of open3d and pyrealsense2 link against `libusb-1.0.so.0`, which minimal systems lack. The wheel `libusb-package`
    contains the same library; loaded globally beforehand, it satisfies both.
    """
    try:
        return _load_globally("libusb-1.0.so.0")
    except OSError:
        pass
    try:
        import libusb_package

        return _load_globally(str(libusb_package.get_library_path()))
    except (ImportError, OSError) as err:
        raise MissingDependencyError(
            "libusb-1.0.so.0: not found, Open3D and pyrealsense2 need it: pip install libusb-package"
        ) from err


def _load_globally(path: str) -> Any:
    """Load a library whose functions those loaded later may use, while the result is kept."""
    from cffi import FFI

    return FFI().dlopen(path, os.RTLD_NOW | os.RTLD_GLOBAL)


@functools.cache
def realsense() -> Any:
    """Return the module `pyrealsense2`, safe to use beside ROS.

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


class DeviceSource:
    """The device that settings name: on the USB bus, or a file of the library's own recorder (`.db3`, older ones `.bag`).

    Args:
        config: Names it.

    Raises:
        FileError: If it is a file that is absent.

    Attributes:
        reopens: Whether opening a silent device again may help; a recording ends, and would only restart.
    """

    def __init__(self, config: RealSenseConfig) -> None:
        self._config = config
        self._path = Path(config.file)
        self.reopens = not config.file
        if config.file and not self._path.is_file():
            raise FileError(self._path, "no such file")
        self._context = realsense().context()

    def find(self) -> Any:
        """Return the `pyrealsense2.device`; a `CameraError` if it is not available now, a `FileError` if it is not a recording."""
        if self._config.file:
            return self._open_file()
        devices = {
            _info(device, realsense().camera_info.serial_number): device for device in self._context.query_devices()
        }
        if not devices:
            raise CameraError(f"camera {self._config.serial}".strip() + ": no RealSense device is connected")
        serial = self._config.serial or next(iter(devices))
        if serial not in devices:
            raise CameraError(f"camera {serial}: is not connected; connected: {', '.join(devices)}")
        return devices[serial]

    def present(self, device: Any) -> bool:
        """Return whether a device that was found is still available."""
        return self._path.is_file() if self._config.file else bool(device.is_connected())

    def _open_file(self) -> Any:
        try:
            # Each time a new context: one context refuses to load the same file twice.
            playback = realsense().context().load_device(str(self._path))
        except RuntimeError as err:
            raise FileError(self._path, f"not a RealSense recording: {err}") from err
        playback.set_real_time(self._config.real_time)
        return playback


def video_profiles(device: Any, stream: Any, form: Any) -> Iterator[tuple[int, Any, Any]]:
    """Iterate over the video profiles of a device: number of the sensor, the sensor, and the profile.

    Args:
        device: Of the library.
        stream: Kind of the stream, such as `realsense().stream.depth`.
        form: Format of its pixels, such as `realsense().format.z16`.
    """
    for number, sensor in enumerate(device.query_sensors()):
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() == stream and profile.format() == form:
                yield number, sensor, profile.as_video_stream_profile()


def list_devices() -> list[str]:
    """Return the name and serial number of each device on the bus; a `MissingDependencyError` without the library."""
    return [describe(device) for device in realsense().context().query_devices()]


def describe(device: Any) -> str:
    """Return the name and serial number of a device."""
    info = realsense().camera_info
    return f"{_info(device, info.name)} {_info(device, info.serial_number)}".strip()


def _info(device: Any, what: Any) -> str:
    return str(device.get_info(what)) if device.supports(what) else ""
