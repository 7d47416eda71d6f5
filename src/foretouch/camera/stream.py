# SPDX-License-Identifier: Apache-2.0
"""One device, open: frames in, organised clouds out. The same code for live, recorded and synthetic frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.deproject import Deprojector
from foretouch.camera.filters import FilterChain
from foretouch.camera.frame_queue import FrameQueue
from foretouch.camera.library import realsense
from foretouch.camera.pairing import ColourBuffer, FramesetMaker
from foretouch.errors import CameraError
from foretouch.types import Cloud

__all__ = ["FrameStream", "Frames", "lens_of"]

_COLOUR_FRAMES = 8


@dataclass(frozen=True, eq=False)
class Frames:
    """What was seen at one moment, as frames of the library.

    Attributes:
        depth: The depth frame.
        colour: The colour frame nearest in time, None if there is none or none was wanted.
    """

    depth: Any
    colour: Any | None = None


class FrameStream:
    """The depth stream of a device, and its colour stream where the settings want colour.

    Args:
        device: A `pyrealsense2.device` that nobody else streams from.
        config: Image size, alignment and filters.

    Attributes:
        filters: Applied to each frame; may be replaced between frames.

    Raises:
        CameraError: If it has no such stream.
        RuntimeError: From the library, if it cannot be opened.
    """

    def __init__(self, device: Any, config: RealSenseConfig) -> None:
        rs = realsense()
        self._config = config
        self._device = rs.recorder(config.record_to, device) if config.record_to else device
        self.filters = FilterChain(config.filters)
        self._align = _aligner(config)
        self._join = FramesetMaker()
        self._lens: tuple[str, Deprojector] | None = None
        lossless = bool(device.is_playback()) and not config.real_time
        # Of a live camera only the newest is kept: a late reader skips frames, and their numbers tell.
        self._depth_box: FrameQueue[Any] = FrameQueue(1, lossless=lossless)
        self._colour_box: FrameQueue[Any] = FrameQueue(_COLOUR_FRAMES, lossless=lossless)
        self._open: list[Any] = []
        try:
            self._period_ms = self._start(rs, exact=not device.is_playback())
        except BaseException:
            self.close()
            raise
        self._colours: ColourBuffer[Any] = ColourBuffer(self._period_ms, lambda frame: float(frame.get_timestamp()))

    @property
    def wants_colour(self) -> bool:
        """Whether a depth frame is of use only with a colour frame."""
        return self._align is not None

    def wait(self, timeout_s: float) -> Frames | None:
        """The next depth frame with its colour frame.

        Args:
            timeout_s: Longest wait for depth; its colour may take two periods more [s].

        Returns:
            The frames, or None if no depth came in time.
        """
        self._drain_colour()  # a recording read at our pace waits while this box is full
        depth = self._depth_box.get(timeout_s)
        if depth is None:
            return None
        return Frames(depth, self._colour_for(float(depth.get_timestamp())) if self.wants_colour else None)

    def cloud(self, frames: Frames) -> Cloud:
        """Frames filtered, aligned and deprojected.

        Args:
            frames: With colour where `wants_colour`.

        Returns:
            (H, W, 3) float32 [m], NaN where there is no depth; rgb where the settings align colour.
        """
        stamp_ns = self._stamp_ns(frames.depth, time.time_ns())
        parts = [frames.depth] if frames.colour is None else [frames.depth, frames.colour]
        frameset = self.filters.process(self._join.make(*parts))
        if self._align is not None:
            frameset = self._align.process(frameset)
        depth = frameset.get_depth_frame()
        points = self._deprojector(depth).points(np.asanyarray(depth.get_data()), depth.get_units())
        # The library owns the pixels and uses them again: copied before the frame goes.
        rgb = None if self._align is None else np.array(frameset.get_color_frame().get_data())
        return Cloud(points, rgb, self._config.optical_frame, stamp_ns)

    def close(self) -> None:
        """Stop and release the device; errors of one that is already gone are of no interest."""
        self._depth_box.close()
        self._colour_box.close()
        while self._open:
            sensor = self._open.pop()
            for step in (sensor.stop, sensor.close):
                try:
                    step()
                except RuntimeError:  # never started, or unplugged: closed is what we want, closed it is
                    continue

    def _start(self, rs: Any, *, exact: bool) -> float:
        """Open all streams, then start all, so that the first frames of both can meet; the depth period [ms]."""
        wanted = [(rs.stream.depth, rs.format.z16, self._depth_box)]
        if self.wants_colour:
            wanted.append((rs.stream.color, rs.format.rgb8, self._colour_box))
        rates: list[int] = []
        for stream, pixel_format, _ in wanted:
            sensor, profile = _find_profile(self._device, stream, pixel_format, self._config if exact else None)
            sensor.open(profile)
            self._open.append(sensor)
            rates.append(int(profile.fps()))
        playback = self._device if len(wanted) > 1 and not exact else None
        if playback is not None:
            playback.pause()  # or it would play the first stream before the second listens
        for sensor, (_, _, box) in zip(tuple(self._open), wanted, strict=True):
            sensor.start(_keep_in(box))
        if playback is not None:
            playback.resume()
        for _, _, box in wanted:
            box.bound()
        return 1000.0 / float(max(1, rates[0]))

    def _colour_for(self, stamp_ms: float) -> Any | None:
        give_up = time.monotonic() + 2.0 * self._period_ms / 1000.0
        while True:
            self._drain_colour()
            colour = self._colours.nearest(stamp_ms)
            left_s = give_up - time.monotonic()
            if colour is not None or left_s <= 0.0 or self._colours.is_past(stamp_ms):
                return colour
            frame = self._colour_box.get(left_s)
            if frame is not None:
                self._colours.add(frame)

    def _drain_colour(self) -> None:
        while (frame := self._colour_box.get(0.0)) is not None:
            self._colours.add(frame)

    def _deprojector(self, depth: Any) -> Deprojector:
        intrinsics = depth.get_profile().as_video_stream_profile().get_intrinsics()
        key = repr(intrinsics)
        if self._lens is None or self._lens[0] != key:
            self._lens = (key, lens_of(intrinsics))
        return self._lens[1]

    def _stamp_ns(self, depth: Any, arrived_ns: int) -> int:
        """Hardware clocks count from when the camera was plugged in: by default they are not believed."""
        rule = self._config.stamp
        own = rule == "frame" or (
            rule == "auto" and depth.get_frame_timestamp_domain() != realsense().timestamp_domain.hardware_clock
        )
        return round(depth.get_timestamp() * 1e6) if own else arrived_ns  # the library counts milliseconds


def lens_of(intrinsics: Any) -> Deprojector:
    """Pixel directions from the library's intrinsics.

    Raises:
        CameraError: If the model of distortion has no inverse here.
    """
    i = intrinsics
    matrix = np.array([[i.fx, 0.0, i.ppx], [0.0, i.fy, i.ppy], [0.0, 0.0, 1.0]])
    model = str(i.model).rpartition(".")[2]
    return Deprojector.of_lens(matrix, i.width, i.height, model, tuple(i.coeffs))


def _keep_in(box: FrameQueue[Any]) -> Callable[[Any], None]:
    """A callback for the library's thread."""

    def receive(frame: Any) -> None:
        frame.keep()  # the library lends only a few frames otherwise
        box.put(frame)

    return receive


def _aligner(config: RealSenseConfig) -> Any | None:
    rs = realsense()
    target = {"none": None, "colour_to_depth": rs.stream.depth, "depth_to_colour": rs.stream.color}[config.align]
    return None if target is None else rs.align(target)


def _find_profile(device: Any, stream: Any, pixel_format: Any, config: RealSenseConfig | None) -> tuple[Any, Any]:
    """The sensor and its profile of the wanted kind, of the wanted size too where `config` is given."""
    sizes = []
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() != stream or profile.format() != pixel_format:
                continue
            video = profile.as_video_stream_profile()
            size = (video.width(), video.height(), video.fps())
            if config is None or size == (config.width, config.height, config.fps):
                return sensor, profile
            sizes.append("{}x{}@{}".format(*size))
    kind = stream.name
    if not sizes:
        raise CameraError(f"{kind} stream: the device has none of format {pixel_format.name}")
    wanted = f"{config.width}x{config.height}@{config.fps}" if config else "any"
    raise CameraError(f"{kind} stream: {wanted} is not offered; offered: {', '.join(sorted(set(sizes)))}")
