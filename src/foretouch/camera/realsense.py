# SPDX-License-Identifier: Apache-2.0
"""A RealSense camera that reports its state and reconnects by itself.

Threads: the thread that reads also opens, waits and reopens; any thread may read `status`, which is replaced as a
whole and never changed.
"""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import DeviceSource, describe, realsense
from foretouch.camera.stream import DepthFrame, FrameStream
from foretouch.errors import CameraError

_SLICE_S = 0.05  # longest uninterrupted wait for a frame
_BACKOFF_S = (0.5, 10.0)  # pause after the first failed attempt, and the longest
_START_S = 5.0  # from opening to the first frame, at most

CameraState = Literal["reconnecting", "streaming", "stalled", "absent", "ended", "closed"]
"""`streaming`: frames arrive. `stalled`: the device is present but sends no frames. `absent`: no such device.
`reconnecting`: it is being opened, or has sent nothing since. `ended`: the end of the recording. `closed`: by the user."""


@dataclass(frozen=True, kw_only=True)
class CameraStatus:
    """The state of a camera at one moment.

    Frames are dropped as `missed` (skipped frame numbers: lost before they reached us, or replaced by a newer one) or
    `bad_frame` (refused by the library, or without a time).
    """

    state: CameraState = "reconnecting"
    reason: str = "not opened yet"  # why, as text; empty while streaming
    device: str = ""  # name and serial number of the device; empty until one was opened
    delivered: int = 0  # images returned
    colourless: int = 0  # images of these without colours, where they are wanted
    dropped: Mapping[str, int] = field(default_factory=dict)  # lost frames by reason
    opened: int = 0  # how often a device was opened
    failures: int = 0  # consecutive attempts without a frame

    def __str__(self) -> str:
        return f"camera: {self.state}: {self.reason}" if self.reason else f"camera: {self.state}"

    @property
    def is_ok(self) -> bool:
        """Whether frames arrive, or none are expected yet or any more."""
        return self.state in {"streaming", "ended", "closed"} or (self.state == "reconnecting" and not self.failures)


class RealSenseCamera:
    """Depth images of a RealSense, one by one, until it is closed.

    A device that is absent, unplugged or silent is reported in `status` and tried again.

    Args:
        config: The device or the recording, and how its frames are processed.
        source: Has the methods of a `DeviceSource`, and is used instead of what the settings name; None for that.
        on_change: Called by the reading thread when the state changes.

    Raises:
        FileError: If the settings name a recording that is absent.
        MissingDependencyError: If pyrealsense2 is missing.
    """

    def __init__(self, config: RealSenseConfig, source: Any, on_change: Callable[[CameraStatus], None]) -> None:
        self.config = config
        self._on_change = on_change
        self._source = DeviceSource(config) if source is None else source
        self._device: Any = None
        self._stream: FrameStream | None = None
        self._heard_s = 0.0  # of the last image, or of the opening, whose first frame may take longer [s]
        self._streaming = False  # whether that was an image
        self._failures = 0  # consecutive attempts without an image
        self._next_attempt_s = 0.0  # end of the pause after a failed attempt [s]
        self._dropped: Counter[str] = Counter()
        self._last_number: int | None = None
        self.status = CameraStatus()  # the state, its reason, and the counts so far; replaced as a whole

    def read(self, timeout_s: float) -> DepthFrame | None:
        """Return the next depth image; None if there was none in time, for the reason that `status` gives.

        Args:
            timeout_s: Longest wait [s]; opening a device may take longer.

        Raises:
            CameraError: If the camera does not offer what the settings ask for.
            FileError: If the file is not a recording.
        """
        deadline = time.monotonic() + timeout_s
        while self.status.state not in {"ended", "closed"}:
            left = deadline - time.monotonic()
            if self._stream is None:
                self._try_to_open(max(0.0, left))
            elif (frame := self._wait(self._stream, min(_SLICE_S, max(0.001, left)))) is not None:
                return frame
            if time.monotonic() >= deadline:
                break
        return None

    def close(self) -> None:
        """Release the device; afterwards nothing can be read."""
        self._release()
        if self.status.state != "ended":
            self._set_state("closed", "")

    def _try_to_open(self, timeout_s: float) -> None:
        """Open the device if the pause since the last attempt is over; else wait."""
        pause = self._next_attempt_s - time.monotonic()
        if pause > 0.0:
            time.sleep(min(pause, timeout_s, _SLICE_S))
            return
        try:
            self._device = self._source.find()
        except CameraError as err:
            self._retry_later("absent", str(err).removeprefix("camera: "))
            return
        try:
            self._stream = FrameStream(self._device, self.config)
        except RuntimeError as err:
            self._device = None
            self._retry_later("reconnecting", f"cannot be opened: {' '.join(str(err).split())}")
            return
        self._last_number = None
        self._heard_s, self._streaming = time.monotonic(), False
        self._update(opened=self.status.opened + 1, device=describe(self._device))
        self._set_state("reconnecting", "opened, waiting for the first frame")

    def _wait(self, stream: FrameStream, timeout_s: float) -> DepthFrame | None:
        depth, now = stream.wait(timeout_s), time.monotonic()
        if depth is None:
            self._on_silence(now, "no frame")
            return None
        number = int(depth.get_frame_number())
        if self._last_number is not None and number > self._last_number + 1:  # of this opening
            self._drop("missed", number - self._last_number - 1)
        self._last_number = number
        try:
            frame = stream.frame(depth)
        except (RuntimeError, CameraError) as err:
            self._drop("bad_frame")
            self._on_silence(now, f"no frame that can be used ({' '.join(str(err).split())})")
            return None
        self._heard_s = now
        self._streaming = True
        self._failures = 0
        colourless = self.status.colourless + (self.config.color and frame.rgb is None)
        self._update(delivered=self.status.delivered + 1, colourless=colourless)
        self._set_state("streaming", "")
        return frame

    def _on_silence(self, now: float, what: str) -> None:
        """Handle the lack of an image; `what` describes it in the reason."""
        silent_s, limit_s = now - self._heard_s, self.config.silence_s if self._streaming else _START_S
        # A recording may not be playing yet in the first second.
        ended = not self._source.reopens and self._device.current_status() == realsense().playback_status.stopped
        if ended and (self._last_number is not None or silent_s > 1.0):
            self._release()
            self._set_state("ended", "the recording has ended")
            return
        reason = f"{what} for {silent_s:.1f} s"
        if not self._source.present(self._device):
            self._release()
            self._retry_later("absent", f"{self.status.device}: was unplugged")
        elif silent_s > limit_s and self._source.reopens:
            self._release()
            self._retry_later("reconnecting", f"{reason}, opening it again")
        elif silent_s > limit_s / 3.0:
            self._set_state("stalled", reason)

    def _retry_later(self, state: CameraState, reason: str) -> None:
        """Note a failed attempt; each pause is twice the last one, up to a limit."""
        pause = min(_BACKOFF_S[0] * 2.0 ** min(self._failures, 60), _BACKOFF_S[1])
        self._failures += 1
        self._next_attempt_s = time.monotonic() + pause
        self._set_state(state, f"{reason}; attempt {self._failures + 1} in {pause:g} s")

    def _drop(self, reason: str, count: int = 1) -> None:
        self._dropped[reason] += count
        self._update(dropped=dict(self._dropped))

    def _release(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream = self._device = None

    def _update(self, **changes: Any) -> None:
        self.status = replace(self.status, **changes)

    def _set_state(self, state: CameraState, reason: str) -> None:
        changed = state != self.status.state
        self._update(state=state, reason=reason, failures=self._failures)
        if changed:
            self._on_change(self.status)
