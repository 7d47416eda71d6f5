# SPDX-License-Identifier: Apache-2.0
"""How fast is GeoGrasp, and are its results those of the original? See README.md."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.common import add_data, cpu_ms, print_rows
from benchmarks.geograsp import baseline, parity
from foretouch.cloud.geometry.pcl_filters import inlier_mask
from foretouch.cloud.geometry.pixel_grid import PixelGrid
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.types import Cloud

ALLOWED = {"grasp": 10, "score": 20}  # rows; the original sums in float32, where near ties may fall either way
CONFIG = GeoGraspConfig()
STABLE = GeoGraspConfig(method="stable")
SLOW = "SciPy, normals everywhere"
TARGETS_MS = {"depth image, pixels known": (4.0, 7.0), "stable, pixels known": (4.0, 7.0)}


def main() -> int:
    """Check that the results are equal, then measure. Exit status 1 if they are not."""
    arguments = argparse.ArgumentParser(description=__doc__)
    add_data(arguments)
    arguments.add_argument("--repeat", type=int, default=5, help="runs of each cloud, of which the fastest is used")
    arguments.add_argument("--every", type=int, default=1, help="use every n-th cloud and row only")
    arguments.add_argument("--fast", action="store_true", help=f"leave out {SLOW!r}, which takes most of the time")
    options = arguments.parse_args()
    if options.data is None:
        arguments.error("--data or FORETOUCH_DATA: where are the recordings?")
    if not prove(options.data, options.every):
        return 1
    measure(options.data, options.every, options.repeat, not options.fast)
    return 0


def prove(data: Path, every: int) -> bool:
    """Compare with the original and with the executed grasps; print the differences."""
    rows = parity.read_reference(data)[::every]
    found = parity.compare_all(rows)
    print(f"original GeoGrasp, {len(rows)} rows: rows that differ, by what")
    for name in (*parity.COUNTS, "status", "initial_points", "grasp", "score", "axis", "centroid", "rotation"):
        print(f"  {name:16} {found[name]:5}   allowed {ALLOWED.get(name, 0) // every}")
    print(f"  {'score undefined':16} {found['score_undefined']:5}   not finite in the original, NaN with a reason here")
    print(f"  {'sign of the axis':16} {found['axis_sign']:5}   undetermined by the rule in side views")
    equal = all(
        n <= ALLOWED.get(name, 0) // every for name, n in found.items() if name not in ("score_undefined", "axis_sign")
    )

    executed = parity.read_executed(data)[::every]
    rest = [grasp for grasp in executed if not parity.reproduces(grasp, grasp.slide_m)]
    unexplained = [grasp for grasp in rest if parity.explaining_slide(grasp) is None]
    print(
        f"executed grasps, {len(executed)}: by the middle slide {len(executed) - len(rest)}, by some {len(executed) - len(unexplained)}"
    )
    return equal and not unexplained


def measure(data: Path, every: int, repeat: int, slow: bool) -> None:
    """Print CPU time of each variant over the clouds, all in the same run."""
    times: dict[str, list[float]] = {}
    rng = np.random.default_rng(0)
    for path in _paths(data)[::every]:
        for name, job in _variants(read_cloud(path), rng).items():
            if name == SLOW and not slow:
                continue
            times.setdefault(name, []).append(cpu_ms(job, 1 if name == SLOW else repeat, least=True))
    print(f"\nCPU ms a cloud, one thread, top view, tip 25, {len(next(iter(times.values())))} clouds")
    print_rows([
        {"": name, "median": float(np.median(values)), "p95": float(np.percentile(values, 95)),
         "mean": float(np.mean(values)), "target": " / ".join(f"{limit:g}" for limit in TARGETS_MS.get(name, ()))}
        for name, values in times.items()
    ])  # fmt: skip


def _variants(cloud: Cloud, rng: np.random.Generator) -> dict[str, Callable[[], object]]:
    xyz = cloud.xyz.reshape(-1, 3)
    grid = PixelGrid.from_rays(xyz)
    if grid is None:
        raise SystemExit("a cloud of the recordings is not a depth image")
    pixels, shape = grid.row * grid.width + grid.column, (grid.height, grid.width)
    shuffled = Cloud(xyz[rng.permutation(len(xyz))])
    # Rotated about the sensor, the rays do not form a lattice of x / z and y / z: only the tree is used.
    turned = Cloud(np.ascontiguousarray(xyz[:, [2, 0, 1]]))

    def planner(config: GeoGraspConfig) -> Callable[[], object]:
        return lambda: plan_grasps(cloud, parity.TOP_VIEW, config, pixels=pixels, image_shape=shape)

    ours: dict[str, Callable[[], object]] = {
        "depth image, pixels known": planner(CONFIG),
        "stable, pixels known": planner(STABLE),
        "depth image, shuffled": lambda: plan_grasps(shuffled, parity.TOP_VIEW, CONFIG),
        "outliers only, no depth image": lambda: inlier_mask(turned.xyz),
    }
    peers = {
        SLOW: lambda: baseline.plan(xyz, parity.TOP_VIEW, CONFIG),
        "SciPy, outliers only": lambda: baseline.inliers(xyz, CONFIG),
    }
    return {**ours, **peers}


def _paths(data: Path) -> list[Path]:
    return sorted((data / "vision2tactile").glob("*/*/cloud-object.pcd"))


if __name__ == "__main__":
    sys.exit(main())
