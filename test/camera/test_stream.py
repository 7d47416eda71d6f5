# SPDX-License-Identifier: Apache-2.0
"""Frames to clouds on the software device: bit-equal points, colour, stamps, refusals."""

import time
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from every_case import every_case

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.device import realsense
from foretouch.camera.realsense import RealSenseCamera
from foretouch.camera.stream import FrameStream
from foretouch.camera.synthetic import SyntheticCamera
from foretouch.errors import CameraError
from foretouch.types import Cloud


def _next(source: SyntheticCamera, stream: FrameStream) -> tuple[Any, Any]:
    source.feed()
    frames = stream.wait(1.0)
    assert frames is not None
    assert (frames[1] is not None) == stream.wants_colour
    return frames


def _cloud(source: SyntheticCamera, config: RealSenseConfig) -> Cloud:
    with closing(FrameStream(source.find(), config)) as stream:
        return stream.cloud(*_next(source, stream))


def test_points_are_those_of_the_librarys_own_pointcloud(images, config):
    def check(align: str) -> None:
        source = SyntheticCamera(images[:1])
        stream = FrameStream(source.find(), config.replace(align=align))
        frames = _next(source, stream)
        ours = stream.cloud(*frames).xyz
        joined = stream._join(*(frame for frame in frames if frame is not None))
        depth = (joined if stream._align is None else stream._align.process(joined)).get_depth_frame()
        theirs = np.asanyarray(realsense().pointcloud().calculate(depth).get_vertices(2)).reshape(ours.shape)
        stream.close()
        seen = np.isfinite(ours).all(axis=-1)
        assert np.array_equal(seen, theirs[..., 2] > 0.0)
        assert seen.mean() > 0.5
        assert np.abs(ours[seen] - theirs[seen]).max() <= 2.4e-7  # an ulp of 2 m

    every_case(["none", "colour_to_depth", "depth_to_colour"], check)


def test_points_frame_colour_and_stamp_of_each_alignment_outlive_their_frame(images, config) -> None:
    image = images[0]
    plain, coloured, turned = (
        _cloud(SyntheticCamera([image]), config.replace(align=align))
        for align in ("none", "colour_to_depth", "depth_to_colour")
    )
    assert (plain.rgb, plain.frame_id) == (None, "camera_depth_optical_frame")
    assert np.array_equal(plain.xyz, image.cloud().xyz, equal_nan=True)
    assert coloured.rgb is not None
    # The library rounds to the neighbour now and then.
    assert (coloured.rgb == image.rgb).all(axis=-1)[image.depth_mm > 0].mean() > 0.98
    assert turned.frame_id == "camera_color_optical_frame"
    for rule in ("auto", "frame", "arrival"):
        before = time.time_ns()
        stamp_ns = _cloud(SyntheticCamera([image]), config.replace(stamp=rule)).stamp_ns
        assert before - 500 <= stamp_ns <= time.time_ns()  # the library keeps milliseconds in a double: 244 ns a step
    assert np.array_equal(turned.rgb, image.rgb)
    source = SyntheticCamera(images[:1])
    stream = FrameStream(source.find(), config.replace(align="colour_to_depth"))
    cloud = stream.cloud(*_next(source, stream))
    assert cloud.rgb is not None
    before = cloud.rgb.copy()
    for _ in range(40):  # more than the library's pool holds
        stream.cloud(*_next(source, stream))
    stream.close()
    assert np.array_equal(cloud.rgb, before)


def test_a_refused_stream_leaves_the_device_free(source: SyntheticCamera, config: RealSenseConfig) -> None:
    with pytest.raises(CameraError, match="depth stream: 640x480@30 is not offered; offered: 424x240@30"):
        FrameStream(source.find(), config.replace(width=640, height=480))
    for _ in range(3):
        stream = FrameStream(source.find(), config)
        assert _next(source, stream) is not None
        stream.close()
        stream.close()
    assert RealSenseCamera(config, source).status.opened == 0
