# SPDX-License-Identifier: Apache-2.0
"""Write what the camera of a scene sees, and the object that is nearest to it, as two cloud files.

    python examples/make_clouds.py SCENE OUT

OUT/<name of the scene>.npz is the whole cloud, an image of points. OUT/<name of the object>.ply holds the points of one object. The same
scene results in the same clouds, so the files of examples/data can be made again.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from foretouch.cloud import TargetConfig, segment, select_targets, write_cloud
from foretouch.errors import ForetouchError
from foretouch.types import Cloud
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.scene_camera import FrameMaker


def clouds(path: str | Path) -> tuple[Cloud, str, Cloud]:
    """The cloud of the first sample of a scene, and the name and the points of its object.

    All points are in the optical frame of the camera [m].
    """
    scene = load_scene(path)
    whole = FrameMaker(scene).frame(0).cloud()
    (nearest,), _ = select_targets(segment(whole).objects, TargetConfig(mode="nearest"))
    return whole, scene.objects[0].name, nearest.cloud


def main() -> int:
    """Exit status 1 after a known failure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="scene file (YAML)")
    parser.add_argument("out", type=Path, help="folder for the clouds")
    arguments = parser.parse_args()
    table = arguments.out / f"{arguments.scene.stem}.npz"
    try:
        whole, name, points = clouds(arguments.scene)
        arguments.out.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(table, xyz=whole.xyz, frame_id=whole.frame_id, stamp_ns=whole.stamp_ns)
        write_cloud(arguments.out / f"{name}.ply", points)
    except ForetouchError as err:
        print(err, file=sys.stderr)
        return 1
    print(f"{table}: {whole.xyz.shape[1]} x {whole.xyz.shape[0]} points")
    print(f"{arguments.out / f'{name}.ply'}: {len(points.xyz)} points")
    return 0


if __name__ == "__main__":
    sys.exit(main())
