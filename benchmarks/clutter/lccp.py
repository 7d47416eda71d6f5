# SPDX-License-Identifier: Apache-2.0
"""PCL's local convexity (`lccp.cpp`) as a peer: compiled when it is first used."""

import hashlib
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.clutter.scenes import cache_folder
from foretouch.types import Cloud, Int32

SOURCE: Final = Path(__file__).with_suffix(".cpp")
SETTINGS: Final = ("0.0075", "0.03", "10.0")  # voxels [m], distance of seeds [m], concavity that is tolerated [deg]
_LIBRARIES: Final = ("segmentation", "octree", "search", "kdtree", "features", "filters", "common")


def program() -> Path | None:
    """The compiled program; None where PCL or a compiler is not installed."""
    headers = sorted(Path("/usr/include").glob("pcl-*"))
    if not headers or shutil.which("g++") is None:
        return None
    built = cache_folder() / f"lccp-{hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]}"
    if not built.is_file():
        options = ["-O2", "-std=c++17", f"-I{headers[-1]}", "-I/usr/include/eigen3"]
        libraries = [f"-lpcl_{name}" for name in _LIBRARIES]
        subprocess.run(["g++", *options, str(SOURCE), "-o", str(built), *libraries], check=True)
    return built


def split(clouds: Sequence[Cloud], clusters: Sequence[Int32], path: Path, runs: int) -> Iterator[tuple[Int32, float]]:
    """The label image (H, W) of each cloud whose clusters are given, and the least CPU time [ms] of so many runs.

    One process splits all of them, in this order: what PCL finds in a few of them depends on what the process did before.
    """
    chosen = [np.flatnonzero(labels) for labels in clusters]
    given = b"".join(
        np.int32(len(index)).tobytes() + cloud.xyz.reshape(-1, 3)[index].tobytes() + labels.ravel()[index].tobytes()
        for cloud, labels, index in zip(clouds, clusters, chosen, strict=True)
    )
    command, at = [str(path), *SETTINGS], 0
    found = [subprocess.run(command, input=given, capture_output=True, check=True).stdout for _ in range(runs)]
    for labels, index in zip(clusters, chosen, strict=True):
        image = np.zeros(labels.shape, np.int32)
        image.ravel()[index] = np.frombuffer(found[0], np.int32, len(index), at)
        at += 4 * len(index)
        yield image, min(float(np.frombuffer(one, np.float64, 1, at)[0]) for one in found)
        at += 8
