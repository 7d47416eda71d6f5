# SPDX-License-Identifier: Apache-2.0
import numpy as np
from sim_builders import CAN, EVERY_CAMERA_FAULT, run, scene

from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.simulation.depth_scene import FIRST_OBJECT
from foretouch.simulation.scene_camera import FrameMaker


def test_a_frame_shows_the_sample_of_its_slot() -> None:
    config = scene(camera={"z_step_m": 0.001})
    image = FrameMaker(config).frame(3)
    state = run(config, "depth", "labels", "window", slot=3)
    np.testing.assert_array_equal(image.labels[state.window], state.labels)
    np.testing.assert_array_equal(image.depth_mm[state.window], np.rint(state.depth * 1000))
    assert image.depth_mm.shape == (480, 640)
    outside = image.labels.copy()
    outside[state.window] = 0
    assert (outside < FIRST_OBJECT).all()


def test_the_segmentation_finds_the_object_in_a_faulty_frame() -> None:
    config = scene(CAN | {"colour": [200, 0, 0]}, camera=EVERY_CAMERA_FAULT)
    image = FrameMaker(config).frame(0)
    found = segment(image.cloud(), SegmentationConfig())
    assert found.status == "ok"
    assert len(found.objects) == 1
    mine, true = found.labels == found.objects[0].id, (image.labels == FIRST_OBJECT) & (image.depth_mm > 0)
    assert (mine & true).sum() / (mine | true).sum() > 0.9
    assert image.rgb[image.labels == FIRST_OBJECT][:, 0].max() > 190


def test_frames_come_back() -> None:
    config = scene(camera=EVERY_CAMERA_FAULT, clutter={})
    first, again, other = FrameMaker(config).frame(1), FrameMaker(config).frame(1), FrameMaker(config).frame(2)
    np.testing.assert_array_equal(first.depth_mm, again.depth_mm)
    assert (first.depth_mm != other.depth_mm).mean() > 0.01
