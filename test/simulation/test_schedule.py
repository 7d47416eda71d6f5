# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import CAN, scene

from foretouch.errors import ConfigError, FileError
from foretouch.simulation.scene_camera import FrameMaker
from foretouch.simulation.schedule import ScheduleConfig, centre_of_objects

START = 1_763_000_000_000_000_000


def test_samples_follow_each_other_and_begin_anew_and_what_is_missing_is_named(tmp_path) -> None:
    schedule = ScheduleConfig(path="scene.yaml", dwell_s=2.5, samples=3, origin_ns=START)
    seconds = [-1000.0, 0.0, 2.499, 2.5, 4.999, 5.0, 7.499, 7.5, 10.0]
    assert [schedule.slot(START + round(s * 1e9)) for s in seconds] == [0, 0, 0, 1, 1, 2, 2, 0, 1]
    with pytest.raises(ConfigError, match="path: is empty"):
        ScheduleConfig().load()
    with pytest.raises((ConfigError, FileError), match=r"none\.yaml"):
        ScheduleConfig(path=str(tmp_path / "none.yaml")).load()


def test_the_object_is_found_near_the_middle_however_the_camera_stands() -> None:
    for tilt in (0, 40):
        config = scene(CAN, camera={"width": 212, "height": 160, "tilt_deg": tilt}, clutter={})
        image = FrameMaker(config).frame(0)
        points = image.cloud().xyz[image.labels == 2]
        assert np.linalg.norm(points - centre_of_objects(config), axis=1).min() < 0.06
