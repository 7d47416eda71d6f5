# SPDX-License-Identifier: Apache-2.0
"""Small recordings of made scenes, for tests that replay one."""

from pathlib import Path

import numpy as np

from benchmarks.random_scenes import random_scene
from foretouch.dataset.formats.rosbag2 import write_bag
from foretouch.types import Cloud, Float32


def scene_cloud(number: int, *, objects: int = 3, width: int = 212, stamp_ns: int = 0) -> Cloud:
    """The organised cloud of a scene that its number decides."""
    rng = np.random.default_rng(number)
    image = random_scene(rng, width, round(width * 120 / 212), objects).render(rng, 0.0005)
    return image.cloud("camera_depth_optical_frame", stamp_ns)


def table_scene(tilt: float = 0.6, rise: float = 0.05, width: int = 320, height: int = 240) -> Float32:
    """(height, width, 3): a table, tilted by `tilt` rad about x, with a box of `rise` [m] height."""
    focal = 0.75 * width
    u, v = np.meshgrid((np.arange(width) - width / 2) / focal, (np.arange(height) - height / 2) / focal)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    normal = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    depth = 0.9 * np.cos(tilt) / -(rays @ normal)
    box = (np.abs(u - 0.05) < 0.06) & (np.abs(v) < 0.06)
    depth = np.where(box, (0.9 * np.cos(tilt) - rise) / -(rays @ normal), depth)
    depth[(depth < 0.0) | (depth > 4.0)] = np.nan
    return np.asarray(rays * depth[..., None], np.float32)


def write_scenes(path: Path, count: int) -> Path:
    """A rosbag2 directory of different scenes, ten a second."""
    stamps = (1_700_000_000_000_000_000 + 100_000_000 * number for number in range(count))
    write_bag(path, (scene_cloud(number, stamp_ns=stamp_ns) for number, stamp_ns in enumerate(stamps)))
    return path
