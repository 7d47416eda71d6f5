# SPDX-License-Identifier: Apache-2.0
"""The streams of one open device: frames in, organised clouds out. Live, recorded and synthetic frames share this code.

Depth and colour frames are paired here, since librealsense's own syncer lets a depth frame go alone, or
drops it, after each start and each pause, and does not report it. So that no depth frame is lost without a count,
frames also wait in our own queues: from Python, the library's `frame_queue` is filled while its thread holds
the interpreter lock, so a full queue that waits for its reader (a recording read at the reader's pace) never ends.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from foretouch.bounded_queue import BoundedQueue
from foretouch.camera.config import FilterConfig, RealSenseConfig
from foretouch.camera.deproject import Deprojector
from foretouch.camera.device import realsense
from foretouch.errors import CameraError
from foretouch.types import Cloud

_Frame = TypeVar("_Frame")
_DEPTH_FRAMES = 1  # of a live camera only the newest is kept: a late reader skips frames, as their numbers show
_COLOUR_FRAMES = 8
_BUFFERED_COLOUR_FRAMES = 32  # more than one camera period of any rate


@dataclass(frozen=True, eq=False)
class Frames:
    """A depth frame of the library and the colour frame nearest in time, None if there is none or none was wanted."""

    depth: Any
    colour: Any | None = None


class FrameStream:
    """The depth stream of a device, and its colour stream where the settings require colour.

    Args:
        device: A `pyrealsense2.device` that is not streaming.
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
        self._join = _FramesetMaker()
        self._lens: tuple[str, Deprojector] | None = None
        lossless = bool(device.is_playback()) and not config.real_time
        when_full: Literal["wait", "drop_oldest"] = "wait" if lossless else "drop_oldest"
        # Unlimited until all streams have started: the library must not wait while it starts one.
        self._depth_queue: BoundedQueue[Any] = BoundedQueue(None, when_full=when_full)
        self._colour_queue: BoundedQueue[Any] = BoundedQueue(None, when_full=when_full)
        self._open: list[Any] = []
        try:
            self._period_ms = self._start(rs, exact=not device.is_playback())
        except BaseException:
            self.close()
            raise
        self._colours: ColourBuffer[Any] = ColourBuffer(self._period_ms, lambda frame: float(frame.get_timestamp()))

    @property
    def wants_colour(self) -> bool:
        """Whether a depth frame is used only with a colour frame."""
        return self._align is not None

    def wait(self, timeout_s: float) -> Frames | None:
        """The next depth frame with its colour frame.

        Args:
            timeout_s: Longest wait for depth; its colour may take two periods more [s].

        Returns:
            The frames, or None if no depth came in time.
        """
        self._drain_colour()  # a recording that is read at our pace waits while this queue is full
        depth = self._depth_queue.get(timeout_s)
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
        """Stop and release the device; errors of one that was unplugged are ignored."""
        self._depth_queue.close("closed")
        self._colour_queue.close("closed")
        while self._open:
            sensor = self._open.pop()
            for step in (sensor.stop, sensor.close):
                try:
                    step()
                except RuntimeError:  # never started, or unplugged: it is closed anyway
                    continue

    def _start(self, rs: Any, *, exact: bool) -> float:
        """Open all streams, then start them together, so that the first frames form pairs.

        Returns the depth period [ms].
        """
        wanted = [(rs.stream.depth, rs.format.z16, self._depth_queue, _DEPTH_FRAMES)]
        if self.wants_colour:
            wanted.append((rs.stream.color, rs.format.rgb8, self._colour_queue, _COLOUR_FRAMES))
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
            colour = self._colours.nearest(stamp_ms)
            left_s = give_up - time.monotonic()
            if colour is not None or left_s <= 0.0 or self._colours.is_past(stamp_ms):
                return colour
            frame = self._colour_queue.get(left_s)
            if frame is not None:
                self._colours.add(frame)

    def _drain_colour(self) -> None:
        while (frame := self._colour_queue.get(0.0)) is not None:
            self._colours.add(frame)

    def _deprojector(self, depth: Any) -> Deprojector:
        intrinsics = depth.get_profile().as_video_stream_profile().get_intrinsics()
        key = repr(intrinsics)
        if self._lens is None or self._lens[0] != key:
            self._lens = (key, lens_of(intrinsics))
        return self._lens[1]

    def _stamp_ns(self, depth: Any, arrived_ns: int) -> int:
        """Hardware clocks count from when the camera was plugged in, so that they are not used by default."""
        rule = self._config.stamp
        use_frame_stamp = rule == "frame" or (
            rule == "auto" and depth.get_frame_timestamp_domain() != realsense().timestamp_domain.hardware_clock
        )
        return round(depth.get_timestamp() * 1e6) if use_frame_stamp else arrived_ns  # the library has ms


class FilterChain:
    """Runs the enabled filters in the order that the library recommends.

    The temporal filter stores earlier frames, so that each stream needs a separate chain.
    """

    def __init__(self, config: FilterConfig) -> None:
        rs = realsense()
        option = rs.option
        self._blocks: list[Any] = []
        if config.decimation.enabled:
            self._add(rs.decimation_filter(), {option.filter_magnitude: config.decimation.magnitude})
        smoothing = config.spatial.enabled or config.temporal.enabled
        if smoothing and config.disparity:
            self._add(rs.disparity_transform(True))
        if config.spatial.enabled:
            self._add(
                rs.spatial_filter(),
                {
                    option.filter_magnitude: config.spatial.magnitude,
                    option.filter_smooth_alpha: config.spatial.smooth_alpha,
                    option.filter_smooth_delta: config.spatial.smooth_delta,
                    option.holes_fill: config.spatial.holes_fill,
                },
            )
        if config.temporal.enabled:
            self._add(
                rs.temporal_filter(),
                {
                    option.filter_smooth_alpha: config.temporal.smooth_alpha,
                    option.filter_smooth_delta: config.temporal.smooth_delta,
                    option.holes_fill: config.temporal.persistence,
                },
            )
        if smoothing and config.disparity:
            self._add(rs.disparity_transform(False))
        if config.hole_filling.enabled:
            self._add(rs.hole_filling_filter(), {option.holes_fill: config.hole_filling.mode})

    def __len__(self) -> int:
        """Number of processing blocks, the conversions to disparity and back included."""
        return len(self._blocks)

    def process(self, frames: Any) -> Any:
        """Filter the depth of a frameset; colour is only decimated, where the library does so."""
        for block in self._blocks:
            frames = block.process(frames).as_frameset()
        return frames

    def _add(self, block: Any, options: Mapping[Any, float] | None = None) -> None:
        for name, value in (options or {}).items():
            block.set_option(name, float(value))
        self._blocks.append(block)


class ColourBuffer(Generic[_Frame]):
    """The last colour frames, by stamp.

    Args:
        period_ms: Between two frames of a stream; a frame farther away than 0.6 of it is no match [ms].
        time_ms: Gives the stamp of a frame [ms].
    """

    def __init__(self, period_ms: float, time_ms: Callable[[_Frame], float]) -> None:
        # Free-running streams of one rate are never more than half a period apart; the rest is jitter.
        self._tolerance_ms = 0.6 * period_ms
        self._time_ms = time_ms
        self._frames: deque[_Frame] = deque(maxlen=_BUFFERED_COLOUR_FRAMES)

    def add(self, frame: _Frame) -> None:
        """Add a frame; the oldest is dropped when there are too many."""
        self._frames.append(frame)

    def nearest(self, stamp_ms: float) -> _Frame | None:
        """Return the frame that matches `stamp_ms`, or None.

        Frames that are too old for it or later ones are dropped.
        """
        while self._frames and self._time_ms(self._frames[0]) < stamp_ms - self._tolerance_ms:
            self._frames.popleft()
        best = min(self._frames, key=lambda frame: abs(self._time_ms(frame) - stamp_ms), default=None)
        if best is None or abs(self._time_ms(best) - stamp_ms) > self._tolerance_ms:
            return None
        return best

    def is_past(self, stamp_ms: float) -> bool:
        """Whether a later frame has arrived, so that none will match any more."""
        return bool(self._frames) and self._time_ms(self._frames[-1]) > stamp_ms + self._tolerance_ms


class _FramesetMaker:
    """Joins frames into a frameset, the input of the library's filters and of its alignment (13 µs)."""

    def __init__(self) -> None:
        rs = realsense()
        self._parts: list[Any] = []
        self._made = rs.frame_queue(1)
        self._block = rs.processing_block(self._join)
        self._block.start(self._made)

    def make(self, *frames: Any) -> Any:
        """Join frames into a `pyrealsense2.composite_frame`."""
        self._parts = list(frames)
        self._block.invoke(frames[0])
        self._parts = []
        return self._made.wait_for_frame().as_frameset()

    def _join(self, _frame: Any, source: Any) -> None:
        source.frame_ready(source.allocate_composite_frame(self._parts))


def lens_of(intrinsics: Any) -> Deprojector:
    """Compute the pixel directions from the library's intrinsics.

    Raises:
        CameraError: If the distortion model is not supported.
    """
    i = intrinsics
    matrix = np.array([[i.fx, 0.0, i.ppx], [0.0, i.fy, i.ppy], [0.0, 0.0, 1.0]])
    model = str(i.model).rpartition(".")[2]
    return Deprojector.of_lens(matrix, i.width, i.height, model, tuple(i.coeffs))


def _keep_in(queue: BoundedQueue[Any]) -> Callable[[Any], None]:
    """Make a callback for the library's thread."""

    def receive(frame: Any) -> None:
        frame.keep()  # the library lends only a few frames otherwise
        queue.put(frame)

    return receive


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
    kind = stream.name
    if not sizes:
        raise CameraError(f"{kind} stream: the device has none of format {pixel_format.name}")
    wanted = f"{config.width}x{config.height}@{config.fps}" if config else "any"
    raise CameraError(f"{kind} stream: {wanted} is not offered; offered: {', '.join(sorted(set(sizes)))}")
