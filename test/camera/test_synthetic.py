# SPDX-License-Identifier: Apache-2.0
"""The feeder of the software device: its rate, its thread, its refusals."""

import threading
import time

import numpy as np
import pytest

from foretouch.camera.realsense import RealSenseCamera
from foretouch.camera.synthetic import SyntheticCamera
from foretouch.errors import CameraError
from foretouch_lab.simulation import DepthImage, random_scene


def test_it_feeds_at_its_rate_its_thread_ends_and_opening_under_full_feed_is_safe(images, config) -> None:
    source = SyntheticCamera(images, fps=50)
    with source:
        time.sleep(0.5)
    fed = source._number
    assert 10 <= fed <= 27
    time.sleep(0.1)
    assert source._number == fed
    assert not any(thread.name == "synthetic-camera" for thread in threading.enumerate())
    source = SyntheticCamera(images, fps=300)
    fast = config.replace(fps=300)
    with source:
        for _ in range(15):
            with RealSenseCamera(fast, source) as camera:
                assert camera.read(2.0) is not None


def test_no_frames_and_a_frame_of_another_size_are_refused(images: list[DepthImage]) -> None:
    small = random_scene(np.random.default_rng(2), 212, 120).render()
    source = SyntheticCamera([images[0], small])
    source.feed()
    with pytest.raises(CameraError, match=r"synthetic frame 1: shape \(120, 212\) is not \(240, 424\)"):
        source.feed()
    with pytest.raises(CameraError, match="no frames to feed"):
        SyntheticCamera([])
