# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import CAN, scene

from foretouch.camera import RealSenseConfig, open_camera
from foretouch.camera.device import realsense
from foretouch.errors import MissingDependencyError
from foretouch.simulation.message_faults import FaultConfig, MessageFaults
from foretouch.simulation.scene_camera import FrameMaker, SceneImages, scene_camera
from foretouch.simulation.show import ShowConfig

START = 1_763_000_000_000_000_000
SMALL = {"width": 212, "height": 160}


class Clock:
    """Time that stands still until it is moved."""

    def __init__(self) -> None:
        self.now_ns = START

    def __call__(self) -> int:
        return self.now_ns


def images(config, **faults) -> tuple[SceneImages, Clock, ShowConfig]:
    clock, show = Clock(), ShowConfig(dwell_s=2.0, origin_ns=START)
    return SceneImages(config, show, MessageFaults(FaultConfig(**faults)), clock), clock, show


def test_what_is_seen_is_the_sample_of_its_stamp() -> None:
    config = scene(camera=SMALL)
    camera, clock, show = images(config)
    for number, seconds in enumerate((0.0, 1.9, 2.0, 5.0)):
        clock.now_ns = START + round(seconds * 1e9) + 123_456
        image = camera(number)
        stamp = camera.stamp_ns(number)
        assert stamp == clock.now_ns - 123_456, "stamps are whole milliseconds"
        expected = FrameMaker(config).frame(show.slot(stamp))
        np.testing.assert_array_equal(image.depth_mm, expected.depth_mm)


def test_a_camera_without_noise_renders_a_sample_once() -> None:
    camera, _, _ = images(scene(camera=SMALL))
    assert camera(0) is camera(1) is camera(7)


def test_noise_differs_from_image_to_image_and_the_object_stays() -> None:
    camera, _, _ = images(scene(camera=SMALL | {"noise": {"sub_pixel": 0.1}}))
    first, second = camera(0), camera(1)
    assert (first.depth_mm != second.depth_mm).mean() > 0.3
    np.testing.assert_array_equal(first.labels, second.labels)


def test_a_sample_without_a_place_is_not_shown(caplog: pytest.LogCaptureFixture) -> None:
    crowded = scene(camera=SMALL, clutter={"count": 20, "size_m": [0.3, 0.3], "distance_m": [0.1, 0.1]})
    camera, _, _ = images(crowded)
    image = camera(0)
    assert not image.depth_mm.any()
    assert "finds no place" in caplog.text


def test_a_faulty_clock_still_tells_which_sample_is_seen() -> None:
    config = scene(camera=SMALL)
    camera, clock, show = images(config, jitter_s=0.02, skew_s=0.05)
    for number in range(40):
        clock.now_ns = START + 1_900_000_000 + number * 5_000_000
        image, stamp = camera(number), camera.stamp_ns(number)
        assert 0.029 <= (stamp - clock.now_ns) / 1e9 <= 0.07
        np.testing.assert_array_equal(image.depth_mm, FrameMaker(config).frame(show.slot(stamp)).depth_mm)
    assert camera.faults.moved == 40


def test_lost_images_have_no_stamp_and_are_counted() -> None:
    camera, _, _ = images(scene(camera=SMALL), drop_share=0.5)
    stamps = [camera(number) and camera.stamp_ns(number) for number in range(100)]
    assert stamps.count(None) == camera.faults.dropped
    assert 25 <= camera.faults.dropped <= 75


def test_it_comes_through_the_software_device_to_the_millimetre_and_the_stamp() -> None:
    try:
        realsense()
    except MissingDependencyError as err:
        pytest.skip(str(err))
    config = scene(CAN, camera=SMALL)
    show = ShowConfig(dwell_s=0.4)
    settings = RealSenseConfig(width=212, height=160, fps=30)
    with scene_camera(config, show, 30) as device, open_camera(settings, device) as camera:
        seen = [cloud for cloud in (camera.read(2.0) for _ in range(20)) if cloud is not None]
    assert len(seen) == 20
    slots = [show.slot(cloud.stamp_ns) for cloud in seen]
    assert len(set(slots)) > 1
    for cloud, slot in zip(seen, slots, strict=True):
        expected = FrameMaker(config).frame(slot).cloud()
        np.testing.assert_allclose(cloud.xyz, expected.xyz, atol=1e-6)
