# SPDX-License-Identifier: Apache-2.0
"""Small recordings of made scenes, for tests that replay one."""

from pathlib import Path

import numpy as np

from foretouch.dataset.bag_writer import write_bag
from foretouch.simulation.depth_scene import random_scene
from foretouch.types import Cloud


def scene_cloud(number: int, *, objects: int = 3, width: int = 212, stamp_ns: int = 0) -> Cloud:
    """The organised cloud of a scene that its number decides."""
    rng = np.random.default_rng(number)
    image = random_scene(rng, width, round(width * 120 / 212), objects).render(rng, 0.0005)
    return image.cloud("camera_depth_optical_frame", stamp_ns)


def write_scenes(path: Path, count: int) -> Path:
    """A rosbag2 directory of different scenes, ten a second."""
    stamps = (1_700_000_000_000_000_000 + 100_000_000 * number for number in range(count))
    write_bag(path, (scene_cloud(number, stamp_ns=stamp_ns) for number, stamp_ns in enumerate(stamps)))
    return path
