# SPDX-License-Identifier: Apache-2.0
"""A software device of librealsense, fed with frames from a program in place of a D415.

Everything behind it, from the library's recorder to the cloud, is the code that a real camera uses.
"""

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from foretouch.camera.device import realsense
from foretouch.errors import CameraError
from foretouch_lab.simulation.depth_scene import RenderedFrame

_DEPTH_UNIT_M = 0.001
_PIXEL_BYTES = 2
_COLOUR_BYTES = 3
_FINER = 2  # pixels of the colour sensor along one of the depth sensor

Frames = Callable[[int], tuple[RenderedFrame, int]]
"""The n-th frame, and its stamp [ns since 1970]. The library stores milliseconds in double precision."""


class SyntheticCamera:
    """Stands for a `DeviceSource`; can be fed, paused, unplugged and plugged in again. As a context manager, it feeds itself.

    Args:
        frames: All of one size and lens; a sequence is repeated, with the times of feeding as stamps.
        fps: Frames per second of `start` [Hz].
        serial: Its serial number.
        color: Whether it has a colour sensor, which sees what the depth sensor sees in twice its resolution.
    """

    def __init__(
        self, frames: Frames | Sequence[RenderedFrame], fps: int = 30, serial: str = "synthetic", *, color: bool = False
    ) -> None:
        if not callable(frames) and not frames:
            raise CameraError("synthetic camera: no frames to feed")
        self.frame: Frames = (
            frames if callable(frames) else lambda number: (frames[number % len(frames)], time.time_ns())
        )
        self._fps = fps
        first, _ = self.frame(0)
        self.shape = first.depth_mm.shape  # (H, W) of every frame
        self._device, self._sensor, self._profile = _software_device(first, fps, serial)
        self._colour_sensor: Any = None
        self._colour_profile: Any = None
        if color:
            self._colour_sensor, self._colour_profile = _colour_sensor(self._device, self._profile, first)
        self._number = 0
        self.plugged = True  # whether the device is present
        self._feeding = threading.Event()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    reopens = True

    @property
    def fault(self) -> str:
        """Why nothing is shown now; "" if something is."""
        return str(getattr(self.frame, "fault", ""))

    def find(self) -> Any:
        """Return the camera; a `CameraError` while it is unplugged."""
        if not self.plugged:
            raise CameraError("synthetic camera: is unplugged")
        return self._device

    def present(self, device: Any) -> bool:  # noqa: ARG002
        """Return whether it is plugged in."""
        return self.plugged

    def feed(self) -> int:
        """Feed one frame now and return its number; a `CameraError` if it has another size than the first."""
        with self._lock:
            number = self._number
            frame, stamp_ns = self.frame(number)
            if frame.depth_mm.shape != self.shape:
                raise CameraError(f"synthetic frame {number}: shape {frame.depth_mm.shape} is not {self.shape}")
            if self.plugged and self._colour_sensor is not None:
                colours = frame.rgb.repeat(_FINER, axis=0).repeat(_FINER, axis=1)
                self._colour_sensor.on_video_frame(_video_frame(self._colour_profile, colours, number, stamp_ns / 1e6))
            if self.plugged:
                self._sensor.on_video_frame(_video_frame(self._profile, frame.depth_mm, number, stamp_ns / 1e6))
            self._number += 1
            return number

    def start(self) -> None:
        """Feed at `fps`, from a thread."""
        self._feeding.set()
        if self._thread is None:
            self._stopping.clear()
            self._thread = threading.Thread(target=self._run, name="synthetic-camera", daemon=True)
            self._thread.start()

    def pause(self) -> None:
        """Send nothing until `start`, as a stalled camera does."""
        self._feeding.clear()

    def close(self) -> None:
        """Stop the thread."""
        self._stopping.set()
        self._feeding.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stopping.is_set():
            self._feeding.wait()
            self.feed()
            # A frame that took too long to make delays the next ones; these are not sent in a burst.
            due = max(due + 1.0 / self._fps, time.monotonic())
            self._stopping.wait(due - time.monotonic())


def _software_device(frame: RenderedFrame, fps: int, serial: str) -> tuple[Any, Any, Any]:
    """Make a device with a depth sensor; it, the sensor and the profile of its stream."""
    rs = realsense()
    device = rs.software_device()
    device.register_info(rs.camera_info.name, "Synthetic D415")
    device.register_info(rs.camera_info.serial_number, serial)
    sensor = device.add_sensor("Stereo Module")
    stream = _stream(rs.stream.depth, rs.format.z16, _PIXEL_BYTES, fps, _intrinsics(frame))
    profile = sensor.add_video_stream(stream).as_video_stream_profile()
    sensor.add_read_only_option(rs.option.depth_units, _DEPTH_UNIT_M)
    device.create_matcher(rs.matchers.default)
    return device, sensor, profile


def _colour_sensor(device: Any, depth: Any, frame: RenderedFrame) -> tuple[Any, Any]:
    """Add a colour sensor in the place of the depth sensor; it and the profile of its stream."""
    rs = realsense()
    sensor = device.add_sensor("RGB Camera")
    stream = _stream(rs.stream.color, rs.format.rgb8, _COLOUR_BYTES, depth.fps(), _intrinsics(frame, _FINER))
    profile = sensor.add_video_stream(stream).as_video_stream_profile()
    same = rs.extrinsics()
    same.rotation, same.translation = np.eye(3).ravel().tolist(), [0.0, 0.0, 0.0]
    depth.register_extrinsics_to(profile, same)
    return sensor, profile


def _stream(kind: Any, form: Any, pixel_bytes: int, fps: int, intrinsics: Any) -> Any:
    stream = realsense().video_stream()
    stream.type, stream.fmt, stream.bpp, stream.fps = kind, form, pixel_bytes, fps
    stream.index, stream.uid = 0, int(kind)
    stream.height, stream.width, stream.intrinsics = intrinsics.height, intrinsics.width, intrinsics
    return stream


def _intrinsics(frame: RenderedFrame, finer: int = 1) -> Any:
    """Return the library's intrinsics of an image, or of one that divides its pixels."""
    rs = realsense()
    height, width = frame.depth_mm.shape
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = finer * width, finer * height
    intrinsics.fx, intrinsics.fy = finer * float(frame.K[0, 0]), finer * float(frame.K[1, 1])
    intrinsics.ppx, intrinsics.ppy = (finer * (float(frame.K[k, 2]) + 0.5) - 0.5 for k in (0, 1))
    intrinsics.model, intrinsics.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    return intrinsics


def _video_frame(
    profile: Any, pixels: npt.NDArray[np.uint16] | npt.NDArray[np.uint8], number: int, stamp_ms: float
) -> Any:
    """Make a frame of the library: of depth (H, W) [mm], or of colours (H, W, 3)."""
    rs = realsense()
    frame = rs.software_video_frame()
    frame.pixels = np.ascontiguousarray(pixels)  # the library copies it
    frame.bpp = _PIXEL_BYTES if pixels.ndim == 2 else _COLOUR_BYTES
    frame.stride = pixels.shape[1] * frame.bpp
    frame.depth_units = _DEPTH_UNIT_M
    frame.timestamp, frame.domain = stamp_ms, rs.timestamp_domain.system_time
    frame.frame_number, frame.profile = number, profile
    return frame
