# SPDX-License-Identifier: Apache-2.0
"""How long does segmentation take, and does it find all objects? See README.md."""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.experiments.tradeoff_perception import overlaps
from foretouch.libusb import ensure_libusb
from foretouch.simulation.depth_scene import FIRST_OBJECT, random_scene
from foretouch.types import Cloud

Labels = npt.NDArray[np.int32]
N_OBJECTS = 3
OBJECTS = range(FIRST_OBJECT, FIRST_OBJECT + N_OBJECTS)  # labels in the truth
N_SCENES = 50


def ours(cloud: Cloud) -> Labels:
    """Labels by this package."""
    return segment(cloud, SegmentationConfig()).labels


def open3d_pipeline(cloud: Cloud) -> Labels:
    """A common pipeline: crop, RANSAC plane, DBSCAN of the points above it, small clusters dropped."""
    import open3d

    flat = cloud.xyz.reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        index = np.flatnonzero((flat[:, 2] > 0.16) & (flat[:, 2] < 2.0))
    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(flat[index].astype(np.float64)))
    open3d.utility.random.seed(0)
    plane, _ = points.segment_plane(0.01, 3, 100)
    plane = np.array(plane) * np.sign(plane[3])
    above = flat[index] @ plane[:3] + plane[3] > 0.006
    objects = points.select_by_index(np.flatnonzero(above))
    clusters = np.asarray(objects.cluster_dbscan(0.01, 10)) + 1
    keep = np.bincount(clusters) >= 150
    keep[0] = False
    labels = np.zeros(len(flat), np.int32)
    labels[index[above]] = np.where(keep, np.cumsum(keep), 0)[clusters]
    return labels.reshape(cloud.xyz.shape[:-1])


def scenes(width: int, height: int) -> list[tuple[str, Cloud, Labels]]:
    """One generated scene, clean, noisy and with flying pixels, and the shared one if available."""
    result = []
    for name, noise_m, flying in (("exact", 0.0, False), ("noise", 0.0015, False), ("flying", 0.0015, True)):
        rng = np.random.default_rng(1)
        image = random_scene(rng, width, height).render(rng, noise_m, flying)
        result.append((f"{width}x{height} {name}", image.cloud(), image.labels))
    shared = Path(os.environ.get("FORETOUCH_DATA", "")) / "scenes" / f"oblique_{width}x{height}.npz"
    if "FORETOUCH_DATA" in os.environ and shared.is_file():
        with np.load(shared) as scene:
            result.append((f"{width}x{height} oblique", Cloud(scene["xyz"]), scene["labels"].astype(np.int32)))
    return result


def cpu_ms(function: Callable[[Cloud], Labels], cloud: Cloud, repeats: int) -> float:
    """Median CPU time of a call [ms], all threads of the process; each call gets a new copy of the cloud."""
    times = []
    for _ in range(repeats + 1):
        fresh = Cloud(cloud.xyz.copy())
        start = time.process_time()
        function(fresh)
        times.append((time.process_time() - start) * 1e3)
    return statistics.median(times[1:])


def check_generated() -> None:
    """Objects found and least overlap on the generated scenes."""
    print(f"\n{N_SCENES} generated scenes of {N_OBJECTS} objects, 848x480")
    print(f"{'effects':<28}{'wrong number':>13}{'least IoU':>11}{'mean IoU':>10}")
    for name, noise_m, flying in (("exact", 0.0, False), ("noise 1 mm", 0.001, False), ("and flying", 0.001, True)):
        wrong, all_overlaps = 0, []
        for seed in range(N_SCENES):
            rng = np.random.default_rng(seed)
            image = random_scene(rng).render(rng, noise_m, flying)
            labels = ours(image.cloud())
            wrong += int(labels.max()) != N_OBJECTS
            all_overlaps += overlaps(labels, image.labels, OBJECTS)
        print(f"{name:<28}{wrong:>13}{min(all_overlaps):>11.3f}{np.mean(all_overlaps):>10.3f}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=51)
    parser.add_argument("--peer-repeats", type=int, default=3, help="of Open3D; 0 leaves it out")
    options = parser.parse_args()
    ensure_libusb()
    all_scenes = scenes(848, 480) + scenes(1280, 720)
    print(f"{'scene':<20}{'objects':>9}{'IoU ours':>22}{'Open3D objects':>16}{'IoU Open3D':>22}")
    for name, cloud, truth in all_scenes:
        mine, theirs = ours(cloud), open3d_pipeline(cloud)
        texts = ["/".join(f"{value:.3f}" for value in overlaps(labels, truth, OBJECTS)) for labels in (mine, theirs)]
        print(f"{name:<20}{mine.max():>9}{texts[0]:>22}{theirs.max():>16}{texts[1]:>22}")
    check_generated()
    print(f"\n{'CPU ms, median':<20}{'ours':>9}{'no order':>10}{'Open3D':>10}")
    for name, cloud, _ in all_scenes:
        flat = cloud.xyz.reshape(-1, 3)
        listed = Cloud(flat[np.isfinite(flat[:, 2])])
        times = [cpu_ms(ours, cloud, options.repeats), cpu_ms(ours, listed, options.repeats)]
        peer = cpu_ms(open3d_pipeline, cloud, options.peer_repeats) if options.peer_repeats else float("nan")
        print(f"{name:<20}{times[0]:>9.2f}{times[1]:>10.2f}{peer:>10.1f}")


if __name__ == "__main__":
    main()
