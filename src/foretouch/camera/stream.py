# SPDX-License-Identifier: Apache-2.0
"""The depth stream of one open device: frames in, depth images out. Live, recorded and synthetic frames share this code.

Frames wait in our own queue, so that none is lost without a count: from Python, the library's `frame_queue` is filled
while its thread holds the interpreter lock, so a full queue that waits for its reader (a recording read at the reader's
pace) never ends.
"""

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from foretouch.bounded_queue import BoundedQueue
from foretouch.camera.colours import ColourAligner, colour_profile
from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import realsense, video_profiles
from foretouch.errors import CameraError
from foretouch.types import AnyArray, Cloud, UInt8
from foretouch.types.camera import CameraModel

_LATEST_MS: Final = 2**63 / 1e6  # stamps are 64 bits of nanoseconds


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A depth image, its camera, and perhaps its colours."""

    depth: AnyArray  # (H, W) uint16, distance along the optical axis; 0 without depth
    scale_m: float  # metres per unit of it
    camera: CameraModel
    frame_id: str  # optical frame of the camera
    stamp_ns: int  # time of measurement [ns]
    rgb: UInt8 | None = None  # (H, W, 3) uint8 of the same pixels, black without depth

    def cloud(self) -> Cloud:
        """Make the organised cloud of the image."""
        return Cloud.from_depth(
            self.depth, self.camera, self.scale_m, frame_id=self.frame_id, stamp_ns=self.stamp_ns, rgb=self.rgb
        )


class FrameStream:
    """The depth stream of a device, and the colours of its images if the settings ask for them.

    Args:
        device: A `pyrealsense2.device` that is not streaming yet.
        config: What to open, and how frames are processed.

    Raises:
        CameraError: If it has no such stream.
        RuntimeError: Of the library, if it cannot be opened.
    """

    def __init__(self, device: Any, config: RealSenseConfig) -> None:
        self._config = config
        waits = device.is_playback() and not config.real_time
        # Unlimited until the stream has started: the library must not wait while it starts.
        queue = self._queue = BoundedQueue[Any](None, when_full="wait" if waits else "drop_oldest")
        wanted = None if device.is_playback() else config
        number, sensor, profile = _find_profile(device, wanted)
        self._camera = library_camera(profile.get_intrinsics())
        self._device = device  # or the library would end a recording
        colours = self._colours = ColourAligner() if config.color else None

        def receive(frame: Any) -> None:  # not of `self`, which the library would keep alive
            frame.keep()  # the library lends only a few otherwise
            if colours is not None and frame.get_profile().stream_type() == realsense().stream.color:
                colours.add(frame)
            else:
                queue.put(frame)

        opened = {number: (sensor, [profile])}
        if self._colours is not None:
            number, sensor, colour = colour_profile(device, wanted)
            opened = {number: (sensor, [colour])} | opened  # first, so that no depth image waits for it
            if len(opened) == 1:
                opened[number][1].append(colour)
        self._sensors = [sensor for sensor, _ in opened.values()]
        try:
            for sensor, profiles in opened.values():
                sensor.open(profiles)
                sensor.start(receive)
        except BaseException:
            self.close()
            raise
        queue.capacity = (
            1  # of a live camera only the newest is kept: a late reader skips frames, as their numbers show
        )

    def wait(self, timeout_s: float) -> Any | None:
        """Return the next depth frame; None if there was none in time [s]."""
        return self._queue.get(timeout_s)

    def frame(self, depth: Any) -> DepthFrame:
        """Copy a depth frame out of the library's memory, with its colours if they are wanted and there are any.

        Raises:
            CameraError: If it has no time that can be used.
        """
        stamp_ns, image = self._stamp_ns(depth, time.time_ns()), depth.as_depth_frame()
        pixels = np.array(image.get_data())
        rgb = None if self._colours is None else self._colours.colours(depth)
        return DepthFrame(pixels, image.get_units(), self._camera, self._config.optical_frame, stamp_ns, rgb)

    def close(self) -> None:
        """Stop and release the device; errors of one that was unplugged are ignored."""
        self._queue.close("closed")
        for sensor in self._sensors:
            for step in (sensor.stop, sensor.close):
                with suppress(RuntimeError):  # never started, or unplugged: it is closed anyway
                    step()

    def _stamp_ns(self, depth: Any, arrived_ns: int) -> int:
        """Hardware clocks count from when the camera was plugged in, so that they are not used by default."""
        is_hardware = depth.get_frame_timestamp_domain() == realsense().timestamp_domain.hardware_clock
        use_arrival = {"frame": False, "arrival": True, "auto": is_hardware}[self._config.stamp]
        if use_arrival:
            return arrived_ns
        stamp_ms = float(depth.get_timestamp())
        if not 0.0 <= stamp_ms < _LATEST_MS:
            raise CameraError(f"stamp: {stamp_ms} ms is no time; camera.stamp `arrival` takes the time of arrival")
        return round(stamp_ms * 1e6)


def library_camera(intrinsics: Any) -> CameraModel:
    """Return the library's intrinsics; a `CameraError` if their distortion is not OpenCV's."""
    i = intrinsics
    if any(i.coeffs) and i.model != realsense().distortion.brown_conrady:
        raise CameraError(f"depth stream: distortion {list(i.coeffs)} ({i.model}): only brown_conrady can be undone")
    return CameraModel(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy, tuple(i.coeffs))


def _find_profile(device: Any, config: RealSenseConfig | None) -> tuple[int, Any, Any]:
    """Find the number, sensor and profile of the depth stream; of the size and rate of `config`, unless it is None."""
    rs, sizes = realsense(), []
    for number, sensor, video in video_profiles(device, rs.stream.depth, rs.format.z16):
        size = (video.width(), video.height(), video.fps())
        if config is None or size == (config.width, config.height, config.fps):
            return number, sensor, video
        sizes.append("{}x{}@{}".format(*size))
    if config is None or not sizes:
        raise CameraError("depth stream: the device has none of format z16")
    raise CameraError(
        f"depth stream: {config.width}x{config.height}@{config.fps} is not offered; "
        f"offered: {', '.join(sorted(set(sizes)))}"
    )
