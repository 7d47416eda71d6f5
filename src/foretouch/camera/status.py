# SPDX-License-Identifier: Apache-2.0
"""What a camera is doing and why, and when a silent one is opened again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from foretouch.camera.config import TimeoutConfig

__all__ = ["CameraState", "CameraStatus", "Watchdog"]

CameraState = Literal["reconnecting", "streaming", "stalled", "absent", "ended", "closed"]


@dataclass(frozen=True, kw_only=True)
class CameraStatus:
    """A snapshot.

    Attributes:
        state: `streaming`: frames arrive. `stalled`: the device is there, clouds are not. `absent`: no such device.
            `reconnecting`: it is being opened, or was and has sent nothing yet. `ended`: the recording is over.
            `closed`: by the user.
        reason: Why, in words; empty while streaming.
        device: Name and serial number of the device; empty until one was opened.
        received: Depth frames that the device made, as far as its frame numbers tell: delivered + the sum of dropped.
        delivered: Clouds handed out.
        dropped: Frames by the reason they were lost for: `missed` (skipped frame numbers: lost before they reached
            us, or overtaken by a newer one), `no_colour` (no colour frame of its time came), `bad_frame` (the library refused it).
        opened: How often a device was opened.
        failures: Attempts in a row that brought no frame.
        since_frame_s: Age of the last frame at the time of the snapshot [s]; None before the first.
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
        """Whether frames arrive, or none are to be expected yet or any more."""
        return self.state in {"streaming", "ended", "closed"} or (self.state == "reconnecting" and not self.failures)


class Watchdog:
    """Decides from times alone whether to wait, to call the camera stalled, or to open it again.

    Attributes:
        config: The timeouts; may be replaced.
        failures: Attempts in a row that brought no frame.
        next_attempt_s: When the pause after a failed attempt is over.

    All times are seconds of one monotonic clock.
    """

    def __init__(self, config: TimeoutConfig) -> None:
        self.config = config
        self._heard_at = 0.0  # last frame, or the opening
        self._streaming = False
        self.failures = 0
        self.next_attempt_s = 0.0

    def opened(self, now_s: float) -> None:
        """A device was opened; it may be silent for a while."""
        self._heard_at, self._streaming = now_s, False

    def frame(self, now_s: float) -> None:
        """A frame came that a cloud could be made of: all is well again."""
        self._heard_at, self._streaming = now_s, True
        self.failures = 0

    def failed(self, now_s: float) -> float:
        """An attempt brought nothing; returns the pause before the next [s], twice the last one."""
        pause = min(self.config.backoff_min_s * 2.0 ** min(self.failures, 60), self.config.backoff_max_s)
        self.failures += 1
        self.next_attempt_s = now_s + pause
        return pause

    def silent_s(self, now_s: float) -> float:
        """Time since the last frame, or since the opening if there was none [s]."""
        return now_s - self._heard_at

    def verdict(self, now_s: float) -> Literal["wait", "stalled", "reopen"]:
        """What to make of a device that is open and silent."""
        silent = self.silent_s(now_s)
        if not self._streaming:
            return "reopen" if silent > self.config.start_s else "wait"
        if silent > self.config.reopen_s:
            return "reopen"
        return "stalled" if silent > self.config.stall_s else "wait"
