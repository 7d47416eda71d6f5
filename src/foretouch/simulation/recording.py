# SPDX-License-Identifier: Apache-2.0
"""Small recordings of synthetic scenes: what tests and the demo replay where there is no camera."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foretouch.config import Settings, setting
from foretouch.dataset.bag_writer import DEFAULT_TOPIC, write_bag
from foretouch.simulation.depth_scene import random_scene
from foretouch.types import Cloud


@dataclass(frozen=True, kw_only=True)
class SceneRecordingConfig(Settings):
    """What is recorded: a new scene in each cloud."""

    count: int = setting(20, "Number of clouds", minimum=0)
    width: int = setting(212, "Columns of the depth image", unit="px", minimum=16, maximum=1920)
    height: int = setting(120, "Rows of the depth image", unit="px", minimum=16, maximum=1080)
    objects: int = setting(3, "Objects on the table", minimum=0, maximum=8)
    noise_m: float = setting(0.0005, "Standard deviation of the depth at 1 m", unit="m", minimum=0.0, maximum=0.05)
    flying_pixels: bool = setting(False, "Whether pixels on a depth edge lie between both sides")
    colour: bool = setting(False, "Whether the points carry colours")
    rate_hz: float = setting(10.0, "Clouds a second", unit="Hz", minimum=0.1, maximum=90.0)
    start_s: int = setting(1_700_000_000, "Stamp of the first cloud", unit="s since 1970", minimum=0)
    frame_id: str = setting("camera_depth_optical_frame", "Frame of the clouds")
    seed: int = setting(0, "Decides all", minimum=0)


def scene_clouds(config: SceneRecordingConfig) -> Iterator[Cloud]:
    """Organised clouds of random scenes; each depends on the seed and its own number alone."""
    step_ns = round(1e9 / config.rate_hz)
    for number in range(config.count):
        rng = np.random.default_rng([config.seed, number])
        scene = random_scene(rng, config.width, config.height, config.objects)
        image = scene.render(rng, config.noise_m, config.flying_pixels)
        stamp_ns = config.start_s * 1_000_000_000 + number * step_ns
        yield image.cloud(config.frame_id, stamp_ns, with_rgb=config.colour)


def record_scenes(path: str | Path, config: SceneRecordingConfig | None = None, topic: str = DEFAULT_TOPIC) -> int:
    """Write a rosbag2 directory of scenes.

    Args:
        path: Directory to be made; must not exist.
        config: What to record.
        topic: Where.

    Returns:
        Number of clouds.

    Raises:
        FileError: If the path exists or cannot be made.
        ConfigError: If so many objects find no place.
    """
    return write_bag(path, scene_clouds(config if config is not None else SceneRecordingConfig()), topic)
