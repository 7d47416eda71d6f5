# SPDX-License-Identifier: Apache-2.0
"""The streams of one open device: frames in, organised clouds out. Live, recorded and synthetic frames share this code.

Depth and colour frames are paired here, since librealsense's own syncer lets a depth frame go alone, or
drops it, after each start and each pause, and does not report it. So that no depth frame is lost without a count,
frames also wait in our own queues: from Python, the library's `frame_queue` is filled while its thread holds
the interpreter lock, so a full queue that waits for its reader (a recording read at the reader's pace) never ends.
"""

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from foretouch.camera.bounded_queue import BoundedQueue
from foretouch.camera.config import FilterConfig, RealSenseConfig
from foretouch.camera.deproject import Deprojector
from foretouch.camera.device import realsense
from foretouch.errors import CameraError
from foretouch.types import Cloud

_Frame = TypeVar("_Frame")


class FrameStream:
    """The depth stream of a device, and its colour stream where the settings require colour.

    The `pyrealsense2.device` is not streaming yet. A `CameraError` if it has no such stream, or a `RuntimeError` of the
    library if it cannot be opened.
    """

    def __init__(self, device: Any, config: RealSenseConfig) -> None:
        rs = realsense()
        self._config = config
        self._device = rs.recorder(config.record_to, device) if config.record_to else device
        self.filters = FilterChain(config.filters)  # may be replaced between frames
        self._align = _aligner(config)
        self._join = _FramesetMaker()
        self._lens: tuple[str, Deprojector] | None = None
        when_full: Literal["wait", "drop_oldest"] = (
            "wait" if device.is_playback() and not config.real_time else "drop_oldest"
        )
        # Unlimited until all streams have started: the library must not wait while it starts one.
        self._depth_queue, self._colour_queue = (BoundedQueue[Any](None, when_full=when_full) for _ in range(2))
        self._open: list[Any] = []
        try:
            self._period_ms = self._start(rs, exact=not device.is_playback())
        except BaseException:
            self.close()
            raise
        self._colours = _ColourBuffer[Any](self._period_ms, lambda frame: float(frame.get_timestamp()))

    @property
    def wants_colour(self) -> bool:
        """Whether a depth frame is used only with a colour frame."""
        return self._align is not None

    def wait(self, timeout_s: float) -> tuple[Any, Any | None] | None:
        """The next depth frame, and the colour frame nearest in time, if one is wanted and came; None without depth.

        Its colour may take two periods more than the longest wait for depth [s].
        """
        self._drain_colour()  # a recording that is read at our pace waits while this queue is full
        depth = self._depth_queue.get(timeout_s)
        if depth is None:
            return None
        return depth, self._colour_for(float(depth.get_timestamp())) if self.wants_colour else None

    def cloud(self, depth: Any, colour: Any | None) -> Cloud:
        """(H, W, 3) points of a depth frame filtered, aligned and deprojected, and rgb where the settings align colour."""
        stamp_ns = self._stamp_ns(depth, time.time_ns())
        frameset = self.filters(self._join(*([depth] if colour is None else [depth, colour])))
        if self._align is not None:
            frameset = self._align.process(frameset)
        image = frameset.get_depth_frame()
        points = self._deprojector(image).points(np.asanyarray(image.get_data()), image.get_units())
        # The library owns the pixels and uses them again: copied before the frame goes.
        rgb = None if self._align is None else np.array(frameset.get_color_frame().get_data())
        return Cloud(points, rgb, self._config.optical_frame, stamp_ns)

    def close(self) -> None:
        """Stop and release the device; errors of one that was unplugged are ignored."""
        self._depth_queue.close("closed")
        self._colour_queue.close("closed")
        while self._open:
            sensor = self._open.pop()
            for step in (sensor.stop, sensor.close):
                with suppress(RuntimeError):  # never started, or unplugged: it is closed anyway
                    step()

    def _start(self, rs: Any, *, exact: bool) -> float:
        """Open all streams, then start them together, so that the first frames form pairs; the depth period [ms]."""
        # Of a live camera only the newest depth is kept: a late reader skips frames, as their numbers show.
        wanted = [(rs.stream.depth, rs.format.z16, self._depth_queue, 1)]
        if self.wants_colour:
            wanted.append((rs.stream.color, rs.format.rgb8, self._colour_queue, 8))
        rates: list[int] = []
        for stream, pixel_format, *_ in wanted:
            sensor, profile = _find_profile(self._device, stream, pixel_format, self._config if exact else None)
            sensor.open(profile)
            self._open.append(sensor)
            rates.append(int(profile.fps()))
        playback = self._device if len(wanted) > 1 and not exact else None
        if playback is not None:
            playback.pause()  # or it would play the first stream before the second listens
        for sensor, (_, _, queue, _) in zip(tuple(self._open), wanted, strict=True):
            sensor.start(_keep_in(queue))
        if playback is not None:
            playback.resume()
        for _, _, queue, capacity in wanted:
            queue.capacity = capacity
        return 1000.0 / float(max(1, rates[0]))

    def _colour_for(self, stamp_ms: float) -> Any | None:
        give_up = time.monotonic() + 2.0 * self._period_ms / 1000.0
        while True:
            self._drain_colour()
            colour, is_past = self._colours.nearest(stamp_ms)
            left_s = give_up - time.monotonic()
            if colour is not None or left_s <= 0.0 or is_past:
                return colour
            if (frame := self._colour_queue.get(left_s)) is not None:
                self._colours.add(frame)

    def _drain_colour(self) -> None:
        while (frame := self._colour_queue.get(0.0)) is not None:
            self._colours.add(frame)

    def _deprojector(self, depth: Any) -> Deprojector:
        intrinsics = depth.get_profile().as_video_stream_profile().get_intrinsics()
        key = repr(intrinsics)
        if self._lens is None or self._lens[0] != key:
            self._lens = (key, _lens_of(intrinsics))
        return self._lens[1]

    def _stamp_ns(self, depth: Any, arrived_ns: int) -> int:
        """Hardware clocks count from when the camera was plugged in, so that they are not used by default."""
        is_hardware = depth.get_frame_timestamp_domain() == realsense().timestamp_domain.hardware_clock
        use_arrival = {"frame": False, "arrival": True, "auto": is_hardware}[self._config.stamp]
        return arrived_ns if use_arrival else round(depth.get_timestamp() * 1e6)  # the library has ms


class FilterChain:
    """Runs the enabled filters in the order that the library recommends.

    The temporal filter stores earlier frames, so that each stream needs a separate chain.
    """

    def __init__(self, config: FilterConfig) -> None:
        rs, option = realsense(), realsense().option
        spatial, temporal = config.spatial, config.temporal
        smoothing = spatial.enabled or temporal.enabled
        magnitude = ((option.filter_magnitude, "magnitude"),)
        amounts = ((option.filter_smooth_alpha, "smooth_alpha"), (option.filter_smooth_delta, "smooth_delta"))
        steps = (
            (config.decimation, config.decimation.enabled, rs.decimation_filter, magnitude),
            (config, smoothing, lambda: rs.disparity_transform(True), ()),
            (spatial, spatial.enabled, rs.spatial_filter, (*magnitude, *amounts)),
            (temporal, temporal.enabled, rs.temporal_filter, amounts),
            (config, smoothing, lambda: rs.disparity_transform(False), ()),
            (config.hole_filling, config.hole_filling.enabled, rs.hole_filling_filter, ((option.holes_fill, "mode"),)),
        )
        self._blocks: list[Any] = []
        for settings, enabled, make, options in steps:
            if enabled:
                self._blocks.append(make())
                for one, name in options:
                    self._blocks[-1].set_option(one, float(getattr(settings, name)))

    def __call__(self, frames: Any) -> Any:
        """Filter the depth of a frameset; colour is only decimated, where the library does so."""
        for block in self._blocks:
            frames = block.process(frames).as_frameset()
        return frames


class _ColourBuffer(Generic[_Frame]):
    """The last colour frames, by stamp; one farther away than 0.6 of the stream's period is no match."""

    def __init__(self, period_ms: float, time_ms: Callable[[_Frame], float]) -> None:
        # Free-running streams of one rate are never more than half a period apart; the rest is jitter.
        self._tolerance_ms = 0.6 * period_ms
        self._time_ms = time_ms
        self._frames: deque[_Frame] = deque(maxlen=32)  # more than one period of any rate

    def add(self, frame: _Frame) -> None:
        """Add a frame; the oldest is dropped when there are too many."""
        self._frames.append(frame)

    def nearest(self, stamp_ms: float) -> tuple[_Frame | None, bool]:
        """The frame that matches a stamp, if any, and whether a later one has arrived, so that none will match any more.

        Frames that are too old for it or later ones are dropped.
        """
        while self._frames and self._time_ms(self._frames[0]) < stamp_ms - self._tolerance_ms:
            self._frames.popleft()
        near = [one for one in self._frames if abs(self._time_ms(one) - stamp_ms) <= self._tolerance_ms]
        best = min(near, key=lambda frame: abs(self._time_ms(frame) - stamp_ms), default=None)
        return best, bool(self._frames) and self._time_ms(self._frames[-1]) > stamp_ms + self._tolerance_ms


class _FramesetMaker:
    """Joins frames into a frameset, the input of the library's filters and of its alignment (13 µs)."""

    def __init__(self) -> None:
        rs = realsense()
        self._parts: tuple[Any, ...] = ()
        self._made = rs.frame_queue(1)
        self._block = rs.processing_block(
            lambda _, source: source.frame_ready(source.allocate_composite_frame(list(self._parts)))
        )
        self._block.start(self._made)

    def __call__(self, *frames: Any) -> Any:
        self._parts = frames
        self._block.invoke(frames[0])
        self._parts = ()
        return self._made.wait_for_frame().as_frameset()


def _lens_of(intrinsics: Any) -> Deprojector:
    """Pixel directions from the library's intrinsics; a `CameraError` if the distortion model is not supported."""
    i = intrinsics
    matrix = np.array([[i.fx, 0.0, i.ppx], [0.0, i.fy, i.ppy], [0.0, 0.0, 1.0]])
    return Deprojector.of_lens(matrix, i.width, i.height, str(i.model).rpartition(".")[2], tuple(i.coeffs))


def _keep_in(queue: BoundedQueue[Any]) -> Callable[[Any], None]:
    """A callback for the library's thread."""

    def _put(frame: Any) -> None:
        frame.keep()  # the library lends only a few frames otherwise
        queue.put(frame)

    return _put


def _aligner(config: RealSenseConfig) -> Any | None:
    rs = realsense()
    target = {"none": None, "colour_to_depth": rs.stream.depth, "depth_to_colour": rs.stream.color}[config.align]
    return None if target is None else rs.align(target)


def _find_profile(device: Any, stream: Any, pixel_format: Any, config: RealSenseConfig | None) -> tuple[Any, Any]:
    """Find the sensor and profile of a stream; of the size and rate of `config`, unless it is None."""
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
    if config is None or not sizes:
        raise CameraError(f"{stream.name} stream: the device has none of format {pixel_format.name}")
    raise CameraError(
        f"{stream.name} stream: {config.width}x{config.height}@{config.fps} is not offered; "
        f"offered: {', '.join(sorted(set(sizes)))}"
    )
