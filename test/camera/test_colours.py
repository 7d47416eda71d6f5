# SPDX-License-Identifier: Apache-2.0
"""Colours of a device with a colour sensor of twice the resolution: aligned by the library, matched in time, and never at the cost of depth."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest
from camera_builders import opened, record

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.stream import FrameStream
from foretouch.errors import CameraError
from foretouch_lab.simulation.software_camera import SyntheticCamera


def _agreement(rgb: Any, image: Any) -> float:
    """The share of pixels with depth whose colours are those of the picture; the library rounds to the nearest ray."""
    has_depth = image.depth_mm > 0
    assert not rgb[~has_depth].any()
    return float((np.abs(rgb[has_depth].astype(int) - image.rgb[has_depth]).max(axis=-1) == 0).mean())


def test_each_depth_image_has_the_colours_of_its_pixels_and_the_same_points(images, config) -> None:
    source = SyntheticCamera(images, color=True)
    with opened(config.replace(color=True), source) as camera:
        camera.read(0.0)
        for image in images:
            source.feed()
            frame = camera.read(1.0)
            assert frame is not None
            assert np.array_equal(frame.depth, image.depth_mm)
            assert np.array_equal(frame.cloud().xyz, image.cloud().xyz, equal_nan=True)
            assert _agreement(frame.cloud().rgb, image) > 0.95
        assert (camera.status.delivered, camera.status.colourless) == (len(images), 0)
    with opened(config, source) as camera:  # that does not ask for colours
        camera.read(0.0)
        source.feed()
        frame = camera.read(1.0)
        assert frame is not None
        assert (frame.rgb, camera.status.colourless) == (None, 0)


def test_depth_without_colours_of_its_time_is_delivered_and_counted(images, config, monkeypatch) -> None:
    source = SyntheticCamera(images, color=True)
    with opened(config.replace(color=True), source) as camera:
        camera.read(0.0)
        monkeypatch.setattr(source, "_colour_sensor", None)  # which sends nothing any more
        for image in images:
            source.feed()
            frame = camera.read(1.0)
            assert frame is not None
            assert np.array_equal(frame.depth, image.depth_mm)
            assert frame.rgb is None
        assert (camera.status.delivered, camera.status.colourless) == (len(images), len(images))


def test_a_device_without_colours_is_refused_by_name(source: SyntheticCamera, config: RealSenseConfig) -> None:
    with pytest.raises(
        CameraError, match=r"color stream: the device has none of format rgb8 at 30 Hz: set camera\.color"
    ):
        FrameStream(source.find(), config.replace(color=True))
    with closing(FrameStream(source.find(), config)) as stream:
        source.feed()
        assert stream.wait(1.0) is not None


def test_a_recording_of_the_library_keeps_its_colours(tmp_path, images, config) -> None:
    recorded = record(tmp_path / "colours.db3", SyntheticCamera(images, color=True), config.replace(color=True), 3)
    played = RealSenseConfig(file=str(tmp_path / "colours.db3"), real_time=False, color=True)
    with opened(played) as camera:
        frames = []
        while camera.status.state != "ended":
            frame = camera.read(1.0)
            frames += [] if frame is None else [frame]
    assert len(frames) == 3
    for frame, cloud, image in zip(frames, recorded, images, strict=True):
        assert np.array_equal(frame.cloud().xyz, cloud.xyz, equal_nan=True)
        assert frame.rgb is not None
        assert _agreement(frame.rgb, image) > 0.95
