# SPDX-License-Identifier: Apache-2.0
"""Write a small recording of synthetic depth scenes, for replay without a camera.

    python examples/make_recording.py OUT [key=value ...]

OUT is a rosbag2 directory with MCAP storage. The keys are the settings of `SceneRecordingConfig` below, such as
`count=50 width=424 height=240 seed=7`. The same settings result in the same clouds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foretouch.config import Settings, parse_overrides, setting
from foretouch.dataset.formats.rosbag2 import write_bag
from foretouch.errors import ForetouchError
from foretouch.types import Cloud
from foretouch_lab.simulation import random_scene


@dataclass(frozen=True, kw_only=True)
class SceneRecordingConfig(Settings):
    """What is recorded: a new scene in each cloud."""

    count: int = setting(20, "Number of clouds", minimum=0)
    width: int = setting(212, "Columns of the depth image", unit="px", bounds=(16, 1920))
    height: int = setting(120, "Rows of the depth image", unit="px", bounds=(16, 1080))
    objects: int = setting(3, "Number of objects on the table", bounds=(0, 8))
    noise_m: float = setting(0.0005, "Standard deviation of the depth at 1 m", unit="m", bounds=(0.0, 0.05))
    flying_pixels: bool = setting(False, "Whether pixels on a depth edge lie between both sides")
    colour: bool = setting(False, "Whether the points carry colours")
    rate_hz: float = setting(10.0, "Rate of the clouds", unit="Hz", bounds=(0.1, 90.0))
    start_s: int = setting(1_700_000_000, "Stamp of the first cloud", unit="s since 1970", minimum=0)
    frame_id: str = setting("camera_depth_optical_frame", "Frame of the clouds")
    seed: int = setting(0, "Seed of the scenes", minimum=0)


def scene_clouds(config: SceneRecordingConfig) -> Iterator[Cloud]:
    """Organised clouds of random scenes; each depends on the seed and its own number alone."""
    step_ns = round(1e9 / config.rate_hz)
    for number in range(config.count):
        rng = np.random.default_rng([config.seed, number])
        scene = random_scene(rng, config.width, config.height, config.objects)
        image = scene.render(rng, config.noise_m, config.flying_pixels)
        stamp_ns = config.start_s * 1_000_000_000 + number * step_ns
        yield image.cloud(config.frame_id, stamp_ns, with_rgb=config.colour)


def record_scenes(path: str | Path, config: SceneRecordingConfig) -> int:
    """Write a rosbag2 directory of scenes, which must not exist; returns the number of clouds."""
    return write_bag(path, scene_clouds(config))


def main() -> int:
    """Exit status 1 after a known failure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", help="directory to create")
    parser.add_argument("settings", nargs="*", metavar="key=value")
    arguments = parser.parse_args()
    try:
        config = SceneRecordingConfig.from_mapping(parse_overrides(arguments.settings))
        count = record_scenes(arguments.out, config)
    except ForetouchError as err:
        print(err, file=sys.stderr)
        return 1
    print(f"{arguments.out}: {count} clouds of {config.width} x {config.height}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
