# SPDX-License-Identifier: Apache-2.0
"""Absent, stalled, unplugged and back again, on the library's own software device."""

import logging
import re
import time
from collections.abc import Callable

import numpy as np
import pytest

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import list_devices
from foretouch.camera.realsense import RealSenseCamera
from foretouch.camera.synthetic import SyntheticCamera


def _until(camera: RealSenseCamera, wanted: Callable[[], bool], limit_s: float = 10.0) -> None:
    """Read, as a user would, until something holds."""
    deadline = time.monotonic() + limit_s
    while not wanted():
        camera.read(0.02)
        assert time.monotonic() < deadline, camera.status


def test_a_running_camera_streams_organised_clouds(source, config, images):
    with source, RealSenseCamera(config, source) as camera:
        clouds = [cloud for cloud, _ in zip(camera, range(4), strict=False)]
        status = camera.status
    assert status.state == "streaming"
    assert status.reason == ""
    assert status.device == "Synthetic D415 synthetic"
    assert status.delivered >= 4
    stamps = [cloud.stamp_ns for cloud in clouds]
    assert stamps == sorted(set(stamps))
    truths = [image.cloud().xyz for image in images]
    for cloud in clouds:
        assert any(np.array_equal(cloud.xyz, truth, equal_nan=True) for truth in truths)
    assert (camera.status.state, camera.status.reason) == ("closed", "closed by the user")
    assert camera.read(0.5) is None
    assert list(camera) == []


def test_received_is_delivered_plus_missed(source: SyntheticCamera, config: RealSenseConfig) -> None:
    with RealSenseCamera(config, source) as camera:
        camera.read(0.0)
        for burst in (1, 1, 4, 1, 3, 1):  # only the newest frame is kept for a late reader
            for _ in range(burst):
                source.feed()
            time.sleep(0.05)
            assert camera.read(1.0) is not None
        status = camera.status
    assert (status.delivered, dict(status.dropped)) == (6, {"missed": 5})
    assert status.received == source._number == 11


def test_a_silent_camera_stalls_is_opened_again_and_recovers(source, config, caplog):
    caplog.set_level(logging.INFO, logger="foretouch.camera")
    with source, RealSenseCamera(config, source) as camera:
        assert camera.read(2.0) is not None
        status = camera.status
        assert status.received == status.delivered + sum(status.dropped.values())
        source.pause()
        _until(camera, lambda: "camera: stalled: no frame for " in caplog.text)
        _until(camera, lambda: "camera: reconnecting: no frame for " in caplog.text)
        _until(camera, lambda: camera.status.opened >= status.opened + 2)  # the second opening stays silent as well
        assert camera.status.failures >= 2
        source.start()
        _until(camera, lambda: camera.status.state == "streaming")
        assert camera.status.failures == 0
    assert re.search(r"reconnecting: no frame for .*attempt 2 in 0\.05 s", caplog.text)


def test_an_unplugged_camera_is_absent_until_it_is_back(source: SyntheticCamera, config: RealSenseConfig) -> None:
    told: list[str] = []
    with source, RealSenseCamera(config, source, lambda status: told.append(status.state)) as camera:
        assert camera.read(2.0) is not None
        source.plugged = False
        _until(camera, lambda: camera.status.state == "absent")
        assert "Synthetic D415 synthetic: was unplugged; attempt 2 in 0.05 s" in camera.status.reason
        _until(camera, lambda: camera.status.failures >= 3)
        assert "synthetic camera: is unplugged" in camera.status.reason
        source.plugged = True
        _until(camera, lambda: camera.status.state == "streaming")
    changes = [state for state in told if state != "reconnecting"]
    assert changes == ["streaming", "absent", "streaming", "closed"]


def test_an_absent_camera_is_named_and_costs_no_processor_time(source, config) -> None:
    source.plugged = False
    with RealSenseCamera(config, source) as camera:
        started, used = time.monotonic(), time.process_time()
        assert camera.read(0.5) is None
        assert time.monotonic() - started == pytest.approx(0.5, abs=0.2)
        assert time.process_time() - used < 0.2
        assert 2 <= camera.status.failures <= 6
    assert not any("Synthetic" in device for device in list_devices())
    with RealSenseCamera(config.replace(serial="000000000000")) as camera:
        assert camera.read(0.3) is None
        assert camera.status.state == "absent"
        for part in ("camera 000000000000: ", "connected", "attempt"):
            assert part in camera.status.reason
