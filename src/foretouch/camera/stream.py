# SPDX-License-Identifier: Apache-2.0
"""The depth stream of one open device: frames in, depth images out, with the colours that the library aligns with them. Live, recorded and synthetic frames share this code.

Frames wait in our own queue, so that none is lost without a count: from Python, the library's `frame_queue` is filled
while its thread holds the interpreter lock, so a full queue that waits for its reader (a recording read at the reader's
pace) never ends.
"""

import math
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from foretouch.base.bounded_queue import BoundedQueue
from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import realsense, video_profiles
from foretouch.errors import CameraError
from foretouch.types import AnyArray, Cloud, UInt8
from foretouch.types.camera import CameraModel

_LATEST_MS: Final = 2**63 / 1e6  # stamps are 64 bits of nanoseconds


_KEPT: Final = 8  # latest colour frames
_TOLERANCE_MS: Final = 20.0  # largest difference between the times of a depth frame and its colours
_WAIT_S: Final = 0.02  # longest wait of a depth frame for its colours


class ColourAligner:
    """Keeps the latest colour frames, and gives each depth frame the colours of its pixels. Thread-safe."""

    def __init__(self) -> None:
        rs = realsense()
        self._frames: deque[Any] = deque(maxlen=_KEPT)
        self._arrived = threading.Condition()
        self._align = rs.align(rs.stream.depth)
        pair = self._pair = list[Any]()  # not of `self`, which the library's block would keep alive
        self._joined = rs.frame_queue(1)
        self._join = rs.processing_block(lambda _, source: source.frame_ready(source.allocate_composite_frame(pair)))
        self._join.start(self._joined)

    def add(self, frame: Any) -> None:
        """Keep a colour frame, which the caller has kept from the library."""
        with self._arrived:
            self._frames.append(frame)
            self._arrived.notify_all()

    def colours(self, depth: Any) -> UInt8 | None:
        """Return the colours of a depth frame's pixels.

        Args:
            depth: A frame of the library; it waits up to 20 ms for the colours of its time.

        Returns:
            (H, W, 3) uint8, black where there is no depth; None if no colour frame is within 20 ms, or the library cannot align it.
        """
        frame = self._nearest(depth.get_timestamp())
        if frame is None:
            return None
        self._pair[:] = depth, frame
        try:
            self._join.invoke(depth)
            both = self._joined.wait_for_frame(1000).as_frameset()
            return np.array(self._align.process(both).get_color_frame().get_data())
        except RuntimeError:  # of the library, such as where it does not know how the sensors are mounted
            return None
        finally:
            self._pair.clear()

    def _nearest(self, time_ms: float) -> Any:
        until_s = time.monotonic() + _WAIT_S
        with self._arrived:
            while all(frame.get_timestamp() < time_ms for frame in self._frames):
                if not self._arrived.wait(until_s - time.monotonic()):
                    break
            nearest = min(self._frames, key=lambda frame: abs(frame.get_timestamp() - time_ms), default=None)
        away_ms = math.inf if nearest is None else abs(nearest.get_timestamp() - time_ms)
        return nearest if away_ms <= _TOLERANCE_MS else None


def colour_profile(device: Any, config: RealSenseConfig | None) -> tuple[int, Any, Any]:
    """Find the sensor and profile of the colour stream: of the rate of `config`, at least as large as its depth, or as large as there is.

    Args:
        device: Of the library.
        config: Settings; None takes what a recording holds.

    Returns:
        Number of the sensor, the sensor, and the profile.

    Raises:
        CameraError: If the device has no colour stream of the format rgb8, or none of the rate.
    """
    rs, found = realsense(), []
    for number, sensor, video in video_profiles(device, rs.stream.color, rs.format.rgb8):
        if config is None or video.fps() == config.fps:
            covers = config is None or (video.width() >= config.width and video.height() >= config.height)
            pixels = video.width() * video.height()
            found.append(((not covers, pixels if covers else -pixels), number, sensor, video))
    if not found:
        rate = "" if config is None else f" at {config.fps} Hz"
        raise CameraError(f"color stream: the device has none of format rgb8{rate}: set camera.color to false")
    _, number, sensor, profile = min(found, key=lambda one: one[0])
    return number, sensor, profile


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
