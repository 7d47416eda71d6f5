# SPDX-License-Identifier: Apache-2.0
"""A small synthetic camera on librealsense's own software device, and short timeouts."""

from collections.abc import Iterator
from importlib.util import find_spec

import numpy as np
import pytest

from benchmarks.random_scenes import random_scene
from foretouch.camera import realsense
from foretouch.camera.config import RealSenseConfig
from foretouch_lab.simulation.depth_scene import RenderedFrame
from foretouch_lab.simulation.software_camera import SyntheticCamera

WIDTH, HEIGHT = 424, 240

if find_spec("pyrealsense2") is None:
    collect_ignore_glob = [f"test_{name}.py" for name in ("realsense", "recording", "stream")]


@pytest.fixture(scope="session")
def images() -> list[RenderedFrame]:
    """Three frames that differ."""
    return [random_scene(np.random.default_rng(seed), WIDTH, HEIGHT).render() for seed in range(3)]


@pytest.fixture
def source(images: list[RenderedFrame]) -> Iterator[SyntheticCamera]:
    """Not feeding yet: `feed()` by hand, or `start()`."""
    camera = SyntheticCamera(images, fps=30)
    yield camera
    camera.close()


@pytest.fixture
def config(monkeypatch: pytest.MonkeyPatch) -> RealSenseConfig:
    """The size of the images, and timeouts that a test can wait for."""
    monkeypatch.setattr(realsense, "_BACKOFF_S", (0.05, 0.2))
    monkeypatch.setattr(realsense, "_START_S", 0.6)
    return RealSenseConfig(width=WIDTH, height=HEIGHT, silence_s=0.5)
