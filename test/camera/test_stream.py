# SPDX-License-Identifier: Apache-2.0
"""Frames to clouds on the software device: bit-equal points, stamps, refusals."""

import time
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.realsense import RealSenseCamera
from foretouch.camera.stream import FrameStream
from foretouch.errors import CameraError
from foretouch.types import Cloud
from foretouch_lab.simulation.software_camera import SyntheticCamera


def _next(source: SyntheticCamera, stream: FrameStream) -> Any:
    source.feed()
    depth = stream.wait(1.0)
    assert depth is not None
    return depth


def _cloud(source: SyntheticCamera, config: RealSenseConfig) -> Cloud:
    with closing(FrameStream(source.find(), config)) as stream:
        return stream.frame(_next(source, stream)).cloud()


def test_points_frame_and_stamp_outlive_their_frame(images, config) -> None:
    image, source = images[0], SyntheticCamera(images[:1])
    with closing(FrameStream(source.find(), config)) as stream:
        cloud = stream.frame(_next(source, stream)).cloud()
        for _ in range(40):  # more than the library's pool holds
            stream.frame(_next(source, stream))
    assert (cloud.rgb, cloud.frame_id) == (None, "camera_depth_optical_frame")
    assert np.array_equal(cloud.xyz, image.cloud().xyz, equal_nan=True)
    for rule in ("auto", "frame", "arrival"):
        before = time.time_ns()
        stamp_ns = _cloud(SyntheticCamera([image]), config.replace(stamp=rule)).stamp_ns
        assert before - 500 <= stamp_ns <= time.time_ns()  # the library keeps milliseconds in a double: 244 ns a step


def test_a_refused_stream_leaves_the_device_free(source: SyntheticCamera, config: RealSenseConfig) -> None:
    with pytest.raises(CameraError, match="depth stream: 640x480@30 is not offered; offered: 424x240@30"):
        FrameStream(source.find(), config.replace(width=640, height=480))
    for _ in range(3):
        stream = FrameStream(source.find(), config)
        assert _next(source, stream) is not None
        stream.close()
        stream.close()
    assert RealSenseCamera(config, source, print).status.opened == 0
