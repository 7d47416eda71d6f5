# SPDX-License-Identifier: Apache-2.0
"""Time foretouch's GeoGrasp in turns with the published C++ program, on the same clouds (README.md)."""

import argparse
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.geograsp.parity import GRASP_TOLERANCE_M, ReferenceRow, read_reference
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.types import Cloud, Float64, Grasp
from foretouch_lab.experiments.peers import check_geograsp, geograsp, has_geograsp

STEP = 8  # each eighth cloud


def timed(plan: Callable[[Cloud, ReferenceRow], Grasp | None], rows: Sequence[ReferenceRow]) -> tuple[Float64, Float64]:
    """Return the processor time [ms] (K,) and the contacts (K, 2, 3) [m] of one plan of each row."""
    ms, contacts = np.empty(len(rows)), np.full((len(rows), 2, 3), np.nan)
    for k, row in enumerate(rows):
        cloud = read_cloud(row.cloud)
        began = time.process_time()
        grasp = plan(cloud, row)
        ms[k] = 1e3 * (time.process_time() - began)
        if grasp is not None:
            contacts[k] = grasp.g1, grasp.g2
    return ms, contacts


def first_grasp(cloud: Cloud, row: ReferenceRow, config: GeoGraspConfig) -> Grasp | None:
    """Return the best grasp of foretouch."""
    grasps = plan_grasps(cloud, row.plane, config).grasps
    return grasps[0] if grasps else None


def main() -> None:
    """Print the times of all three in turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("FORETOUCH_DATA", "data")))
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args()
    check_geograsp()
    if not has_geograsp():
        raise SystemExit("needs g++, libpcl-dev and, in FORETOUCH_GEOGRASP, a checkout of the published GeoGrasp")
    rows = [row for row in read_reference(options.data) if row.config.tip_mm == 25.0][:: 3 * STEP]  # of one table
    planners = {
        "C++ GeoGrasp": lambda cloud, row: geograsp(cloud, row.plane, row.config.tip_mm),
        "foretouch, grasp.method=original": lambda cloud, row: first_grasp(cloud, row, row.config),
        "foretouch, default": lambda cloud, row: first_grasp(cloud, row, GeoGraspConfig()),
    }
    with threadpool_limits(1):
        turns = [{name: timed(plan, rows) for name, plan in planners.items()} for _ in range(options.turns)]
    least = {name: np.min([turn[name][0] for turn in turns], axis=0) for name in planners}
    first = next(iter(planners))
    apart = np.linalg.norm(turns[0][first][1] - turns[0]["foretouch, grasp.method=original"][1], axis=2).max(axis=1)
    print(f"{len(rows)} clouds, least of {options.turns} turns, processor time [ms] of one plan on one thread")
    for name, ms in least.items():
        half, most = np.percentile(ms, [50, 95])
        print(f"{name:34s} median {half:6.1f}  p95 {most:6.1f}  C++ / this {np.median(least[first] / ms):5.1f}")
    print(
        f"contacts of the first two within {1e3 * GRASP_TOLERANCE_M:g} mm: {np.sum(apart <= GRASP_TOLERANCE_M)} of {len(rows)}"
    )


if __name__ == "__main__":
    main()
