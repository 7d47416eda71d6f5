# SPDX-License-Identifier: Apache-2.0
"""Which colour frame belongs to a depth frame, and how both become one frameset of the library.

librealsense's own syncer does this too, but it lets a depth frame go alone, or not at all, after each
start and each pause, and does not say so. Here each depth frame is answered for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from foretouch.camera.library import realsense

__all__ = ["ColourBuffer", "FramesetMaker"]

_Frame = TypeVar("_Frame")
_KEPT = 32  # colour frames; more than one camera period of any rate


class ColourBuffer(Generic[_Frame]):
    """The last colour frames, by time stamp.

    Args:
        period_ms: Between two frames of a stream; a frame farther off than 0.6 of it belongs to another [ms].
        time_ms: Gives the stamp of a frame [ms].
    """

    def __init__(self, period_ms: float, time_ms: Callable[[_Frame], float]) -> None:
        # Free-running streams of one rate are never more than half a period apart; the rest is jitter.
        self._tolerance_ms = 0.6 * period_ms
        self._time_ms = time_ms
        self._frames: deque[_Frame] = deque(maxlen=_KEPT)

    def add(self, frame: _Frame) -> None:
        """A new frame; the oldest goes when there are too many."""
        self._frames.append(frame)

    def nearest(self, stamp_ms: float) -> _Frame | None:
        """The frame that belongs to `stamp_ms`, or None; frames too old for it or later ones are forgotten."""
        while self._frames and self._time_ms(self._frames[0]) < stamp_ms - self._tolerance_ms:
            self._frames.popleft()
        best = min(self._frames, key=lambda frame: abs(self._time_ms(frame) - stamp_ms), default=None)
        if best is None or abs(self._time_ms(best) - stamp_ms) > self._tolerance_ms:
            return None
        return best

    def is_past(self, stamp_ms: float) -> bool:
        """Whether a later frame is here already, so that waiting for an earlier one is vain."""
        return bool(self._frames) and self._time_ms(self._frames[-1]) > stamp_ms + self._tolerance_ms


class FramesetMaker:
    """Joins frames into a frameset, the input of the library's filters and of its alignment (13 µs)."""

    def __init__(self) -> None:
        rs = realsense()
        self._parts: list[Any] = []
        self._made = rs.frame_queue(1)
        self._block = rs.processing_block(self._join)
        self._block.start(self._made)

    def make(self, *frames: Any) -> Any:
        """A `pyrealsense2.composite_frame` of frames."""
        self._parts = list(frames)
        self._block.invoke(frames[0])
        self._parts = []
        return self._made.wait_for_frame().as_frameset()

    def _join(self, _frame: Any, source: Any) -> None:
        source.frame_ready(source.allocate_composite_frame(self._parts))
