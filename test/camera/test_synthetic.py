# SPDX-License-Identifier: Apache-2.0
"""The feeder of the software device: its rate, its thread, its refusals."""

import threading
import time

import numpy as np
import pytest

from foretouch.camera import RealSenseCamera, RealSenseConfig, SyntheticCamera
from foretouch.errors import CameraError
from foretouch.simulation import DepthImage, DepthScene, random_scene


def test_it_feeds_at_its_rate_and_its_thread_ends(images: list[DepthImage]) -> None:
    source = SyntheticCamera(images, fps=50)
    with source:
        time.sleep(0.5)
    fed = source._number
    assert 10 <= fed <= 27
    time.sleep(0.1)
    assert source._number == fed
    assert not any(thread.name == "synthetic-camera" for thread in threading.enumerate())


def test_frames_may_be_made_one_by_one(config: RealSenseConfig) -> None:
    scene: DepthScene = random_scene(np.random.default_rng(2), 424, 240)
    asked: list[int] = []

    def frame(number: int) -> DepthImage:
        asked.append(number)
        return scene.moved(0, np.array([0.002 * number, 0.0, 0.0])).render()

    source = SyntheticCamera(frame)
    with RealSenseCamera(config, source) as camera:
        camera.read(0.0)
        for number in range(3):
            assert source.feed() == number
            cloud = camera.read(1.0)
            assert cloud is not None
            assert np.array_equal(cloud.xyz, frame(number).cloud().xyz, equal_nan=True)
    assert asked[:2] == [0, 0]  # once for the size of the device, then as the first frame


def test_no_frames_and_a_frame_of_another_size_are_refused(images: list[DepthImage]) -> None:
    small = random_scene(np.random.default_rng(2), 212, 120).render()
    source = SyntheticCamera([images[0], small])
    source.feed()
    with pytest.raises(CameraError, match=r"synthetic frame 1: shape \(120, 212\) is not \(240, 424\)"):
        source.feed()
    with pytest.raises(CameraError, match="no frames to feed"):
        SyntheticCamera([])


def test_opening_and_closing_under_full_feed_is_safe(images: list[DepthImage], config: RealSenseConfig) -> None:
    source = SyntheticCamera(images, fps=300)
    fast = config.replace(fps=300, align="colour_to_depth")
    with source:
        for _ in range(15):
            with RealSenseCamera(fast, source) as camera:
                assert camera.read(2.0) is not None
