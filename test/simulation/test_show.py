# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from sim_builders import CAN, scene

from foretouch.errors import ConfigError, FileError
from foretouch.simulation.scene_camera import FrameMaker
from foretouch.simulation.show import ShowConfig, middle_of

START = 1_763_000_000_000_000_000


def test_samples_follow_each_other_and_begin_anew() -> None:
    show = ShowConfig(path="scene.yaml", dwell_s=2.5, samples=3, origin_ns=START)
    seconds = [0.0, 2.499, 2.5, 4.999, 5.0, 7.499, 7.5, 10.0]
    assert [show.slot(START + round(s * 1e9)) for s in seconds] == [0, 0, 1, 1, 2, 2, 0, 1]


def test_before_the_beginning_the_first_sample_lies_there() -> None:
    assert ShowConfig(origin_ns=START).slot(START - 10**12) == 0


def test_it_names_what_is_missing(tmp_path) -> None:
    with pytest.raises(ConfigError, match="path: is empty"):
        ShowConfig().load()
    with pytest.raises((ConfigError, FileError), match=r"none\.yaml"):
        ShowConfig(path=str(tmp_path / "none.yaml")).load()


def test_the_object_is_found_near_the_middle_however_the_camera_stands() -> None:
    for tilt in (0, 40):
        config = scene(CAN, camera={"width": 212, "height": 160, "tilt_deg": tilt}, clutter={})
        image = FrameMaker(config).frame(0)
        points = image.cloud().xyz[image.labels == 2]
        assert np.linalg.norm(points - middle_of(config), axis=1).min() < 0.06
