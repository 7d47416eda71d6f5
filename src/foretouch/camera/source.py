# SPDX-License-Identifier: Apache-2.0
"""What is shown in place of a camera: a scene of the laboratory, or a source of another package."""

from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

from foretouch.camera.config import ScheduleConfig
from foretouch.doors import Door


@runtime_checkable
class ImageSource(Protocol):
    """A source of depth images that stands for a camera.

    It is found by its name, as in `run --source NAME` and the parameter `source` of the camera node, or by the suffix of its files,
    such as `.yaml`: it has an entry point for each.
    """

    def nodes(self, show: ScheduleConfig, rate_hz: float | None) -> dict[str, dict[str, Any]]:
        """Return the nodes that show it, by name, with their parameters.

        Args:
            show: What is shown: `path` is the file, or "" for a source that is given by name; it begins now.
            rate_hz: Images per second that the user asks for, if any.

        Raises:
            ForetouchError: If it cannot be shown.
        """
        ...

    def device(self, show: ScheduleConfig, fps: int, *, color: bool) -> Any:
        """Return what feeds the images to librealsense's software device, such as `SyntheticCamera` of the laboratory.

        It has `shape`, the (H, W) of its images; `start()` and `close()`; `fault`, why nothing is shown now, or ""; and what the class
        `foretouch.camera.device.DeviceSource` has: `find()`, `present(device)` and `reopens`.

        Args:
            show: What is shown when.
            fps: Images per second.
            color: Whether it gives an image of colours with each, aligned to it.
        """
        ...


_RESERVED: Final = (
    *("camera", "device"),
    *(".npz", ".npy", ".png", ".tif", ".tiff", ".pcd", ".ply", ".mcap", ".db3", ".bag", ".zstd"),
)
"""What `--source` and the camera node themselves understand."""

SOURCES: Final = Door("foretouch.sources", "source", kind=ImageSource, reserved=_RESERVED)
"""The sources that installed packages add."""


def find_source(given: str) -> ImageSource | None:
    """Return the source that a name, or the suffix of a file or folder, stands for; None if it stands for none."""
    name = Path(given).suffix or given
    source: ImageSource | None = SOURCES.load(name, f"--source {given}") if name in SOURCES else None
    return source
