# SPDX-License-Identifier: Apache-2.0
"""The colours of a device's depth images, aligned with them by the library."""

import math
import threading
import time
from collections import deque
from typing import Any, Final

import numpy as np

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import realsense, video_profiles
from foretouch.errors import CameraError
from foretouch.types import UInt8

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
