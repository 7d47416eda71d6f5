# SPDX-License-Identifier: Apache-2.0
"""PCL's local convexity (`lccp.cpp`) as a peer: compiled when it is first used, where PCL's headers are."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.types import Cloud, Int32

SOURCE: Final = Path(__file__).with_suffix(".cpp")
VOXEL_M, SEED_M, CONCAVITY_DEG = 0.0075, 0.03, 10.0
_LIBRARIES: Final = ("segmentation", "octree", "search", "kdtree", "features", "filters", "common")
_INCLUDES: Final = ("/usr/include", "/usr/local/include")


def cache() -> Path:
    """The folder of what is made once."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "foretouch" / "benchmarks"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def program() -> Path | None:
    """The compiled program; None where PCL or a compiler is absent, or it does not compile."""
    headers = [path for root in _INCLUDES for path in sorted(Path(root).glob("pcl-*"))]
    compiler = os.environ.get("CXX") or shutil.which("g++") or shutil.which("clang++")
    if not headers or compiler is None:
        return None
    name = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    built = cache() / f"lccp-{name}"
    if built.is_file():
        return built
    with tempfile.TemporaryDirectory(dir=cache()) as temporary:
        fresh = Path(temporary) / "lccp"
        include = [f"-I{headers[-1]}", f"-I{headers[-1].parent / 'eigen3'}"]
        libraries = [f"-lpcl_{name}" for name in _LIBRARIES]
        command = [compiler, "-O2", "-std=c++17", *include, str(SOURCE), "-o", str(fresh), *libraries]
        if subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode:
            return None
        fresh.rename(built)
    return built


def split(clouds: Sequence[Cloud], clusters: Sequence[Int32], path: Path) -> tuple[list[Int32], list[float]]:
    """Label images (H, W) of clouds whose clusters are given, and the CPU time of each [ms]."""
    chosen = [np.flatnonzero(labels) for labels in clusters]
    given = b"".join(
        np.int32(len(index)).tobytes() + cloud.xyz.reshape(-1, 3)[index].tobytes() + labels.ravel()[index].tobytes()
        for cloud, labels, index in zip(clouds, clusters, chosen, strict=True)
    )
    command = [str(path), *(str(value) for value in (VOXEL_M, SEED_M, CONCAVITY_DEG))]
    answer = subprocess.run(command, input=given, capture_output=True, check=True).stdout
    images, times, at = [], [], 0
    for labels, index in zip(clusters, chosen, strict=True):
        image = np.zeros(labels.size, np.int32)
        image[index] = np.frombuffer(answer, np.int32, len(index), at)
        at += 4 * len(index)
        times.append(float(np.frombuffer(answer, np.float64, 1, at)[0]))
        at += 8
        images.append(image.reshape(labels.shape))
    return images, times
