# SPDX-License-Identifier: Apache-2.0
"""Absent, stalled, unplugged and back again, on the library's own software device."""

import math
import time

from camera_builders import opened
from counted_work import calls_at_most

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import list_devices
from foretouch_lab.simulation.software_camera import SyntheticCamera


def test_received_is_delivered_plus_missed(source: SyntheticCamera, config: RealSenseConfig) -> None:
    with opened(config, source) as camera:
        camera.read(0.0)
        for burst in (1, 1, 4, 1, 3, 1):  # only the newest frame is kept for a late reader
            for _ in range(burst):
                source.feed()
            time.sleep(0.05)
            assert camera.read(1.0) is not None
        status = camera.status
    assert (status.delivered, dict(status.dropped)) == (6, {"missed": 5})
    assert status.delivered + sum(status.dropped.values()) == source._number == 11


def test_an_absent_camera_is_named_and_costs_little_work(source, config) -> None:
    source.plugged = False
    with opened(config, source) as camera:
        with calls_at_most(10_000):
            assert camera.read(0.5) is None
        assert 2 <= camera.status.failures <= 6
    assert not any("Synthetic" in device for device in list_devices())
    with opened(config.replace(serial="000000000000")) as camera:
        assert camera.read(0.3) is None
        assert camera.status.state == "absent"
        for part in ("camera 000000000000: ", "connected", "attempt"):
            assert part in camera.status.reason


def test_a_frame_without_a_time_is_counted_and_the_next_one_is_taken(images, config) -> None:
    stamps = (math.nan, math.inf, -5e9, 1e40, 1.7e18)
    with opened(config, source := SyntheticCamera(lambda number: (images[number % 3], stamps[number]))) as camera:
        camera.read(0.0)
        for _ in range(4):
            source.feed()
            assert camera.read(0.1) is None
        source.feed()
        frame = camera.read(1.0)
    assert frame is not None
    assert frame.stamp_ns == 1_700_000_000_000_000_000
    assert dict(camera.status.dropped) == {"bad_frame": 4}
