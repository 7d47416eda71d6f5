# SPDX-License-Identifier: Apache-2.0
"""Settings of the RealSense camera, and of a scene in its place."""

from dataclasses import dataclass
from typing import Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError

_MS_NS: Final = 1_000_000


@dataclass(frozen=True, kw_only=True)
class RealSenseConfig(Settings, read_only=True):
    """A RealSense depth camera, live or recorded."""

    serial: str = setting("", "Serial number of the live device; empty for the first one found")
    file: str = setting("", "Recording (.db3 or .bag) to play instead of a live device")
    width: int = setting(848, "Columns of a live image", unit="px", bounds=(64, 3840))
    height: int = setting(480, "Rows of a live image", unit="px", bounds=(64, 2160))
    fps: int = setting(30, "Frames per second of a live device", unit="Hz", bounds=(1, 300))
    color: bool = setting(
        False,
        "Whether the colours of the pixels are read too, and aligned with the depth images by the library; of a live device in"
        " the smallest size that covers them",
    )
    silence_s: float = setting(
        3.0,
        "A camera without a frame for longer is opened again; it is reported as stalled after a third of that",
        bounds=(0.05, 600.0),
    )
    real_time: bool = setting(True, "Whether a recording plays in real time; if not, no frame is lost")
    frame_id: str = setting("", "Frame of the clouds; empty for the optical frame of the depth image")
    stamp: str = setting(
        "auto",
        "Stamp of a cloud: of the frame, of its arrival, or (`auto`) of the frame if that is wall-clock time",
        choices=("auto", "frame", "arrival"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file and self.serial:
            raise ConfigError(f"file: {self.file!r} and serial {self.serial!r} exclude each other")

    @property
    def optical_frame(self) -> str:
        """The frame of the clouds; by default named as by realsense2_camera."""
        return self.frame_id or "camera_depth_optical_frame"


@dataclass(frozen=True, kw_only=True)
class ScheduleConfig(Settings, read_only=True):
    """A scene over time: which of its samples is on the table at a given stamp; camera and hand are given the same.

    They are separate nodes, perhaps in separate processes; the stamp is all that they share about a cloud. So the sample
    is a function of the stamp, and the hand touches the very object that the camera saw.
    """

    path: str = setting("", "Path of the scene file (YAML)")
    dwell_s: float = setting(3.0, "Time that each sample stays on the table", bounds=(0.05, 86400.0))
    samples: int = setting(1000, "Number of samples that are shown before the first comes again", minimum=1)
    origin_ns: int = setting(0, "Time when the first sample is laid on the table, since 1970", minimum=0)

    def slot(self, stamp_ns: int) -> int:
        """Return the sample on the table at a time, such as a cloud's stamp [ns]; before the first, the first."""
        return max(0, stamp_ns - self.origin_ns) // (round(self.dwell_s * 1e3) * _MS_NS) % self.samples
