# SPDX-License-Identifier: Apache-2.0
"""The feeder of the software device: its rate, its thread, its refusals."""

import numpy as np
import pytest

from foretouch.errors import CameraError
from foretouch_lab.simulation import DepthImage, random_scene
from foretouch_lab.simulation.software_camera import SyntheticCamera


def test_no_frames_and_a_frame_of_another_size_are_refused(images: list[DepthImage]) -> None:
    small = random_scene(np.random.default_rng(2), 212, 120).render()
    source = SyntheticCamera([images[0], small])
    source.feed()
    with pytest.raises(CameraError, match=r"synthetic frame 1: shape \(120, 212\) is not \(240, 424\)"):
        source.feed()
    with pytest.raises(CameraError, match="no frames to feed"):
        SyntheticCamera([])
