# SPDX-License-Identifier: Apache-2.0
"""Frames of a scene, and the times at which they are seen."""

from dataclasses import dataclass

import numpy as np
import pytest
from camera_builders import opened
from sim_builders import CAN, run, scene

from foretouch.camera.config import RealSenseConfig, ScheduleConfig
from foretouch.camera.device import realsense
from foretouch.errors import ConfigError, FileError, MissingDependencyError
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT
from foretouch_lab.simulation.scene import centre_of_objects, scheduled_scene
from foretouch_lab.simulation.scene_camera import FrameMaker, SceneImages
from foretouch_lab.simulation.software_camera import SyntheticCamera

START = 1_763_000_000_000_000_000
SMALL = {"width": 212, "height": 160}


@dataclass
class Clock:
    """Time that stands still until it is moved."""

    now_ns: int = START

    def __call__(self) -> int:
        return self.now_ns


def images(config) -> tuple[SceneImages, Clock, ScheduleConfig]:
    clock, schedule = Clock(), ScheduleConfig(dwell_s=2.0, origin_ns=START)
    return SceneImages(config, schedule, clock), clock, schedule


def test_what_is_seen_is_the_sample_of_its_stamp() -> None:
    config = scene(camera=SMALL)
    camera, clock, schedule = images(config)
    for number, seconds in enumerate((0.0, 1.9, 2.0, 5.0)):
        clock.now_ns = START + round(seconds * 1e9) + 123_456
        image, stamp = camera(number)
        assert stamp == clock.now_ns - 123_456, "stamps are whole milliseconds"
        expected = FrameMaker(config).frame(schedule.slot(stamp))
        np.testing.assert_array_equal(image.depth_mm, expected.depth_mm)


def test_a_sample_is_rendered_once_with_noise_of_each_image_and_without_a_place_not_shown(caplog) -> None:
    camera, _, _ = images(scene(camera=SMALL))
    assert camera(0)[0] is camera(1)[0] is camera(7)[0]
    camera, _, _ = images(scene(camera=SMALL | {"noise": {"sub_pixel": 0.1}}))
    first, second = camera(0)[0], camera(1)[0]
    assert (first.depth_mm != second.depth_mm).mean() > 0.3
    np.testing.assert_array_equal(first.labels, second.labels)
    camera, _, _ = images(scene(camera=SMALL, clutter={"count": 20, "distance_m": [0.1, 0.1]}))
    assert not camera(0)[0].depth_mm.any()
    assert "finds no place" in caplog.text
    assert camera.fault in caplog.text
    assert camera.fault.startswith("scene: sample ")


def test_it_comes_through_the_software_device_to_the_millimetre_and_the_stamp() -> None:
    try:
        realsense()
    except MissingDependencyError as err:
        pytest.skip(str(err))
    config = scene(CAN, camera=SMALL)
    schedule = ScheduleConfig(dwell_s=0.4)
    settings = RealSenseConfig(width=212, height=160, fps=30)
    with SyntheticCamera(SceneImages(config, schedule), 30) as device, opened(settings, device) as camera:
        seen = [frame.cloud() for frame in (camera.read(2.0) for _ in range(20)) if frame is not None]
    assert len(seen) == 20
    slots = [schedule.slot(cloud.stamp_ns) for cloud in seen]
    assert len(set(slots)) > 1
    for cloud, slot in zip(seen, slots, strict=True):
        expected = FrameMaker(config).frame(slot).cloud()
        np.testing.assert_allclose(cloud.xyz, expected.xyz, atol=1e-6)


def test_a_frame_shows_the_sample_of_its_slot() -> None:
    config = scene(camera={"z_step_m": 0.001})
    image = FrameMaker(config).frame(3)
    state = run(config, slot=3)
    np.testing.assert_array_equal(image.labels[state.window], state.labels)
    np.testing.assert_array_equal(image.depth_mm[state.window], np.rint(state.depth * 1000))
    assert image.depth_mm.shape == (480, 640)
    outside = image.labels.copy()
    outside[state.window] = 0
    assert (outside < FIRST_OBJECT).all()
    red = FrameMaker(scene(CAN | {"colour": [200, 0, 0]})).frame(0)
    assert red.rgb[red.labels == FIRST_OBJECT][:, 0].max() > 190


def test_samples_follow_each_other_and_begin_anew_and_what_is_missing_is_named(tmp_path) -> None:
    schedule = ScheduleConfig(path="scene.yaml", dwell_s=2.5, samples=3, origin_ns=START)
    seconds = [-1000.0, 0.0, 2.499, 2.5, 4.999, 5.0, 7.499, 7.5, 10.0]
    assert [schedule.slot(START + round(s * 1e9)) for s in seconds] == [0, 0, 0, 1, 1, 2, 2, 0, 1]
    with pytest.raises(ConfigError, match="path: is empty"):
        scheduled_scene(ScheduleConfig())
    with pytest.raises((ConfigError, FileError), match=r"none\.yaml"):
        scheduled_scene(ScheduleConfig(path=str(tmp_path / "none.yaml")))


def test_the_object_is_found_near_the_middle_however_the_camera_stands() -> None:
    for tilt in (0, 40):
        config = scene(CAN, camera={"width": 212, "height": 160, "tilt_deg": tilt}, clutter={})
        image = FrameMaker(config).frame(0)
        points = image.cloud().xyz[image.labels == 2]
        assert np.linalg.norm(points - centre_of_objects(config), axis=1).min() < 0.06
