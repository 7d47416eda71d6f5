# SPDX-License-Identifier: Apache-2.0
"""The state of a camera with its reason, and the decision when a silent one is opened again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from foretouch.camera.config import TimeoutConfig

__all__ = ["CameraState", "CameraStatus", "Watchdog"]

CameraState = Literal["reconnecting", "streaming", "stalled", "absent", "ended", "closed"]


@dataclass(frozen=True, kw_only=True)
class CameraStatus:
    """The state of a camera at one moment.

    Attributes:
        state: `streaming`: frames arrive. `stalled`: the device is present but sends no frames. `absent`: no such
            device. `reconnecting`: it is being opened, or has sent nothing since. `ended`: the end of the recording.
            `closed`: by the user.
        reason: Why, as text; empty while streaming.
        device: Name and serial number of the device; empty until one was opened.
        received: Depth frames that the device made according to its frame numbers: delivered + the sum of dropped.
        delivered: Clouds returned.
        dropped: Lost frames by reason: `missed` (skipped frame numbers: lost before they reached us, or replaced by a
            newer one), `no_colour` (no matching colour frame), `bad_frame` (refused by the library).
        opened: How often a device was opened.
        failures: Consecutive attempts without a frame.
        since_frame_s: Age of the last frame [s]; None before the first.
    """

    state: CameraState = "reconnecting"
    reason: str = "not opened yet"
    device: str = ""
    received: int = 0
    delivered: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    opened: int = 0
    failures: int = 0
    since_frame_s: float | None = None

    @property
    def is_ok(self) -> bool:
        """Whether frames arrive, or none are expected yet or any more."""
        return self.state in {"streaming", "ended", "closed"} or (self.state == "reconnecting" and not self.failures)


class Watchdog:
    """Decides from times alone whether to wait, to report the camera as stalled, or to open it again.

    Attributes:
        config: The timeouts; may be replaced.
        failures: Consecutive attempts without a frame.
        next_attempt_s: End of the pause after a failed attempt; all times are of one monotonic clock [s].
    """

    def __init__(self, config: TimeoutConfig) -> None:
        self.config = config
        self._last_frame_s = 0.0  # last frame, or the opening
        self._streaming = False
        self.failures = 0
        self.next_attempt_s = 0.0

    def opened(self, now_s: float) -> None:
        """Note that a device was opened; its first frame may take longer."""
        self._last_frame_s, self._streaming = now_s, False

    def frame(self, now_s: float) -> None:
        """Note a frame that a cloud could be made of."""
        self._last_frame_s, self._streaming = now_s, True
        self.failures = 0

    def failed(self, now_s: float) -> float:
        """Note a failed attempt; returns the pause before the next [s], twice the last one."""
        pause = min(self.config.backoff_min_s * 2.0 ** min(self.failures, 60), self.config.backoff_max_s)
        self.failures += 1
        self.next_attempt_s = now_s + pause
        return pause

    def silent_s(self, now_s: float) -> float:
        """Time since the last frame, or since the opening without one [s]."""
        return now_s - self._last_frame_s

    def decide(self, now_s: float) -> Literal["wait", "stalled", "reopen"]:
        """Decide what to do with a device that is open and sends nothing."""
        silent = self.silent_s(now_s)
        if not self._streaming:
            return "reopen" if silent > self.config.start_s else "wait"
        if silent > self.config.reopen_s:
            return "reopen"
        return "stalled" if silent > self.config.stall_s else "wait"
