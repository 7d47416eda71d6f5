# SPDX-License-Identifier: Apache-2.0
"""Recorded by the library's own recorder and played back through the same code."""

import time
from pathlib import Path

import numpy as np
import pytest
from camera_builders import opened, record

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.realsense import RealSenseCamera
from foretouch.errors import FileError


def _playing(path: Path, config: RealSenseConfig) -> RealSenseConfig:
    return config.replace(file=str(path), real_time=False)


def test_a_recording_plays_back_bit_for_bit(tmp_path, source, config):
    path = tmp_path / "seen.db3"
    recorded = record(path, source, config, 5)
    with opened(_playing(path, config)) as camera:
        played = {}
        while camera.status.state != "ended":
            frame = camera.read(0.05)
            time.sleep(0.05)  # a slow reader loses nothing
            if frame is not None:
                played[frame.stamp_ns] = frame.cloud()
        status = camera.status
    assert status.state == "ended"
    assert status.reason == "the recording has ended"
    assert status.device == "Synthetic D415 synthetic"
    assert list(played) == [cloud.stamp_ns for cloud in recorded]
    assert dict(status.dropped) == {}
    for cloud in recorded:
        twin = played[cloud.stamp_ns]
        assert np.array_equal(twin.xyz, cloud.xyz, equal_nan=True)
        assert twin.frame_id == cloud.frame_id


def test_files_that_cannot_be_played_are_named(tmp_path, config):
    with pytest.raises(FileError, match=r"gone\.db3: no such file"):
        RealSenseCamera(_playing(tmp_path / "gone.db3", config), None, print)
    for name in ("bad.db3", "bad.bag"):
        path = tmp_path / name
        path.write_bytes(b"no recording" * 100)
        with (
            opened(_playing(path, config)) as camera,
            pytest.raises(FileError, match=rf"{name}: not a RealSense recording"),
        ):
            camera.read(1.0)
