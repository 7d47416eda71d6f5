# SPDX-License-Identifier: Apache-2.0
"""Recordings of a synthetic camera, made by the library's own recorder."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import realsense
from foretouch.camera.realsense import RealSenseCamera
from foretouch.types import Cloud
from foretouch_lab.simulation.software_camera import SyntheticCamera


class _Recorded:
    """A camera whose device records to a file."""

    reopens = True

    def __init__(self, source: SyntheticCamera, path: Path) -> None:
        self._source, self._path = source, path

    def find(self) -> Any:
        return realsense().recorder(str(self._path), self._source.find())

    def present(self, _: Any) -> bool:
        return True


@contextmanager
def opened(config: RealSenseConfig, source: Any = None) -> Iterator[RealSenseCamera]:
    """A camera that is closed at the end."""
    with closing(RealSenseCamera(config, source, lambda _: None)) as camera:
        yield camera


def record(path: Path, source: SyntheticCamera, config: RealSenseConfig, count: int) -> list[Cloud]:
    """Record so many frames; the clouds of them."""
    clouds = []
    with opened(config, _Recorded(source, path)) as camera:
        camera.read(0.0)
        for _ in range(count):
            source.feed()
            frame = camera.read(1.0)
            assert frame is not None, camera.status
            clouds.append(frame.cloud())
    return clouds
