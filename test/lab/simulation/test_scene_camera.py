# SPDX-License-Identifier: Apache-2.0
"""Frames of a scene, and the times at which they are seen."""

import numpy as np
import pytest
from sim_builders import CAN, run, scene

from foretouch.camera.config import RealSenseConfig, ScheduleConfig
from foretouch.camera.device import realsense
from foretouch.camera.message_faults import FaultConfig, MessageFaults
from foretouch.camera.realsense import RealSenseCamera
from foretouch.errors import ConfigError, FileError, MissingDependencyError
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT
from foretouch_lab.simulation.scene import SceneConfig, centre_of_objects, scheduled_scene
from foretouch_lab.simulation.scene_camera import FrameMaker, SceneFrames
from foretouch_lab.simulation.software_camera import SyntheticCamera

START = 1_763_000_000_000_000_000
SMALL = {"width": 212, "height": 160}
SCHEDULE = ScheduleConfig(dwell_s=2.0, origin_ns=START)


class Clock:
    """Time that stands still until it is moved."""

    now_ns = START

    def __call__(self) -> int:
        return self.now_ns


def frames(config: SceneConfig, clock: Clock | None = None, **faults: float) -> SceneFrames:
    return SceneFrames(config, SCHEDULE, MessageFaults(FaultConfig(**faults)), clock or Clock())


def test_what_is_seen_is_the_sample_of_its_stamp_though_the_clock_is_faulty() -> None:
    config, clock = scene(camera=SMALL), Clock()
    camera = frames(config, clock)
    for number, seconds in enumerate((0.0, 1.9, 2.0, 5.0)):
        clock.now_ns = START + round(seconds * 1e9) + 123_456
        image, stamp = camera(number)
        assert stamp == clock.now_ns - 123_456, "stamps are whole milliseconds"
        np.testing.assert_array_equal(image.depth_mm, FrameMaker(config).frame(SCHEDULE.slot(stamp)).depth_mm)
    camera = frames(config, clock, jitter_s=0.02, skew_s=0.05)
    for number in range(40):
        clock.now_ns = START + 1_900_000_000 + number * 5_000_000
        image, stamp = camera(number)
        assert 0.029 <= (stamp - clock.now_ns) / 1e9 <= 0.07
        np.testing.assert_array_equal(image.depth_mm, FrameMaker(config).frame(SCHEDULE.slot(stamp)).depth_mm)
    camera = frames(config, drop_share=0.5)
    assert 25 <= [camera(number)[1] for number in range(100)].count(None) <= 75


def test_a_sample_is_rendered_once_with_noise_of_each_image_and_without_a_place_not_shown(caplog) -> None:
    camera = frames(scene(camera=SMALL))
    assert camera(0)[0] is camera(1)[0] is camera(7)[0]
    camera = frames(scene(camera=SMALL | {"noise": {"sub_pixel": 0.1}}))
    first, second = camera(0)[0], camera(1)[0]
    assert (first.depth_mm != second.depth_mm).mean() > 0.3
    np.testing.assert_array_equal(first.labels, second.labels)
    camera = frames(scene(camera=SMALL, clutter={"count": 20, "distance_m": [0.1, 0.1]}))
    assert not camera(0)[0].depth_mm.any()
    assert camera.fault.startswith("scene: sample ")
    assert "finds no place" in camera.fault
    assert camera.fault in caplog.text


def test_it_comes_through_the_software_device_to_the_millimetre_and_the_stamp() -> None:
    try:
        realsense()
    except MissingDependencyError as err:
        pytest.skip(str(err))
    config, schedule = scene(CAN, camera=SMALL), ScheduleConfig(dwell_s=0.4)
    device = SyntheticCamera(SceneFrames(config, schedule), 30)
    with device, RealSenseCamera(RealSenseConfig(width=212, height=160, fps=30), device) as camera:
        seen = [cloud for cloud in (camera.read(2.0) for _ in range(20)) if cloud is not None]
    assert len(seen) == 20
    slots = [schedule.slot(cloud.stamp_ns) for cloud in seen]
    assert len(set(slots)) > 1
    for cloud, slot in zip(seen, slots, strict=True):
        np.testing.assert_allclose(cloud.xyz, FrameMaker(config).frame(slot).cloud().xyz, atol=1e-6)


def test_a_frame_shows_the_sample_of_its_slot_near_the_middle_however_the_camera_stands() -> None:
    config = scene(camera={"z_step_m": 0.001})
    image, state = FrameMaker(config).frame(3), run(config, "depth_steps", slot=3)
    np.testing.assert_array_equal(image.labels[state.window], state.labels)
    np.testing.assert_array_equal(image.depth_mm[state.window], np.rint(state.depth * 1000))
    assert image.depth_mm.shape == (480, 640)
    red = FrameMaker(scene(CAN | {"colour": [200, 0, 0]})).frame(0)
    assert red.rgb[red.labels == FIRST_OBJECT][:, 0].max() > 190
    for tilt in (0, 40):
        config = scene(CAN, camera=SMALL | {"tilt_deg": tilt}, clutter={})
        image = FrameMaker(config).frame(0)
        points = image.cloud().xyz[image.labels == 2]
        assert np.linalg.norm(points - centre_of_objects(config), axis=1).min() < 0.06


def test_samples_follow_each_other_and_begin_anew_and_what_is_missing_is_named(tmp_path) -> None:
    schedule = ScheduleConfig(path="scene.yaml", dwell_s=2.5, samples=3, origin_ns=START)
    seconds = [-1000.0, 0.0, 2.499, 2.5, 4.999, 5.0, 7.499, 7.5, 10.0]
    assert [schedule.slot(START + round(s * 1e9)) for s in seconds] == [0, 0, 0, 1, 1, 2, 2, 0, 1]
    with pytest.raises(ConfigError, match="path: is empty"):
        scheduled_scene(ScheduleConfig())
    with pytest.raises((ConfigError, FileError), match=r"none\.yaml"):
        scheduled_scene(ScheduleConfig(path=str(tmp_path / "none.yaml")))
