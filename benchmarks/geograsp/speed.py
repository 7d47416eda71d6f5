# SPDX-License-Identifier: Apache-2.0
"""Time foretouch's GeoGrasp in turns with the published C++ program, on the same clouds (README.md)."""

import argparse
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.geograsp.parity import GRASP_TOLERANCE_M, ReferenceRow, read_reference
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.types import Float64

STEP = 8  # each eighth cloud
_LIBRARIES = (
    "visualization", "segmentation", "sample_consensus", "features", "filters", "search", "kdtree", "octree", "io", "common",
)  # fmt: skip
_ANSWER = np.dtype([("ms", np.float64), ("contacts", np.float32, 6)])


def compiled(source: Path, folder: Path) -> Path:
    """Compile the published GeoGrasp of a checkout with the program that times it, and return its path.

    Raises:
        SystemExit: If PCL, a compiler or the checkout is not there.
    """
    pcl = sorted(Path("/usr/include").glob("pcl-*"))
    vtk = sorted(Path("/usr/include").glob("vtk-*"))
    code = source / "geograsp/lib/geograsp/GeoGrasp.cpp"
    if not pcl or not vtk or shutil.which("g++") is None or not code.is_file():
        raise SystemExit(f"needs g++, libpcl-dev and {code}")
    program = folder / "geograsp"
    headers = [
        f"-I{path}"
        for path in (source / "geograsp/include", source / "geograsp/lib", pcl[-1], vtk[-1], "/usr/include/eigen3")
    ]
    own = Path(__file__).with_name("original.cpp")
    libraries = [f"-lpcl_{name}" for name in _LIBRARIES]
    command = ["g++", "-O3", "-std=c++17", "-fopenmp", "-w", *headers, str(own), "-o", str(program)]
    version = vtk[-1].name.partition("-")[2]
    subprocess.run([*command, *libraries, f"-lvtkCommonCore-{version}", "-lboost_system"], check=True)
    return program


def original(program: Path, rows: Sequence[ReferenceRow]) -> tuple[Float64, Float64]:
    """Return the processor time [ms] (K,) and the contacts (K, 2, 3) [m] of one plan of each row by the C++ program."""
    given = b"".join(
        np.int32(row.config.tip_mm).tobytes()
        + np.array([*row.plane.normal, row.plane.offset], np.float32).tobytes()
        + np.int32(len(xyz)).tobytes()
        + xyz.astype(np.float32).tobytes()
        for row in rows
        for xyz in (read_cloud(row.cloud).xyz.reshape(-1, 3),)
    )
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([program], input=given, capture_output=True, check=True, env=environment)
    answers = np.frombuffer(done.stdout, _ANSWER)
    return answers["ms"], answers["contacts"].reshape(-1, 2, 3).astype(np.float64)


def own(rows: Sequence[ReferenceRow], config: GeoGraspConfig | None = None) -> tuple[Float64, Float64]:
    """Return the same of foretouch: by the settings of each row, or by these."""
    ms, contacts = np.empty(len(rows)), np.empty((len(rows), 2, 3))
    for k, row in enumerate(rows):
        cloud = read_cloud(row.cloud)
        began = time.process_time()
        plan = plan_grasps(cloud, row.plane, config or row.config)
        ms[k] = 1e3 * (time.process_time() - began)
        contacts[k] = np.stack([plan.grasps[0].g1, plan.grasps[0].g2]) if plan.grasps else np.nan
    return ms, contacts


def main() -> None:
    """Print the times of all three in turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--source", type=Path, required=True, help="a checkout of the published GeoGrasp")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("FORETOUCH_DATA", "data")))
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args()
    rows = [row for row in read_reference(options.data) if row.config.tip_mm == 25.0][:: 3 * STEP]  # of one table
    with tempfile.TemporaryDirectory() as folder:
        program = compiled(options.source.resolve(), Path(folder))
        planners = {
            "C++ GeoGrasp": lambda: original(program, rows),
            "foretouch, grasp.method=original": lambda: own(rows),
            "foretouch, default": lambda: own(rows, GeoGraspConfig()),
        }
        turns = [{name: plan() for name, plan in planners.items()} for _ in range(options.turns)]
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
