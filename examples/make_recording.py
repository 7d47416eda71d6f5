# SPDX-License-Identifier: Apache-2.0
"""Write a small recording of a simulated scene, for replay without a camera.

    python examples/make_recording.py OUT [key=value ...]

OUT is a rosbag2 directory with MCAP storage. The keys are the settings of `SceneRecordingConfig` below, such as
`scene=config/scenes/touching.yaml count=50 width=424 height=320 seed=7`. The same settings result in the same clouds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from foretouch.config import Settings, parse_overrides, setting
from foretouch.dataset.formats.rosbag2 import write_bag
from foretouch.errors import ForetouchError
from foretouch.types import Cloud
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.scene_camera import FrameMaker

SCENES = Path(__file__).resolve().parents[1] / "config" / "scenes"


@dataclass(frozen=True, kw_only=True)
class SceneRecordingConfig(Settings):
    """What is recorded: another sample of the scene in each cloud."""

    scene: str = setting(str(SCENES / "clutter.yaml"), "Scene file: the objects, and the faults of the camera")
    count: int = setting(20, "Number of clouds", minimum=0)
    width: int = setting(212, "Columns of the depth image", unit="px", bounds=(16, 1920))
    height: int = setting(160, "Rows of the depth image", unit="px", bounds=(16, 1080))
    colour: bool = setting(False, "Whether the points carry colours")
    rate_hz: float = setting(10.0, "Rate of the clouds", unit="Hz", bounds=(0.1, 90.0))
    start_s: int = setting(1_700_000_000, "Stamp of the first cloud", unit="s since 1970", minimum=0)
    frame_id: str = setting("camera_depth_optical_frame", "Frame of the clouds")
    seed: int = setting(0, "Seed of the scene", minimum=0)


def scene_clouds(config: SceneRecordingConfig) -> Iterator[Cloud]:
    """Organised clouds of a scene; each depends on the scene, the seed and its own number alone."""
    changes = {"seed": config.seed, "camera.width": config.width, "camera.height": config.height}
    maker, step_ns = FrameMaker(load_scene(config.scene).updated(changes)), round(1e9 / config.rate_hz)
    for number in range(config.count):
        stamp_ns = config.start_s * 1_000_000_000 + number * step_ns
        yield maker.frame(number).cloud(config.frame_id, stamp_ns, with_rgb=config.colour)


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
