# SPDX-License-Identifier: Apache-2.0
"""Programs of others in C++, called in this process, so that their times compare: PCL's LCCP and the published GeoGrasp.

Each is compiled when it is first used, where g++ and PCL are installed (`apt install g++ libpcl-dev`). GeoGrasp also needs a
checkout of its source, https://github.com/yayaneath/GeoGrasp, whose path is in the environment variable `FORETOUCH_GEOGRASP`.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, ForetouchError, shown
from foretouch.grasp import hand_rotation
from foretouch.types import AnyArray, Cloud, Grasp, Int32, Plane

_SYSTEM: Final = Path("/usr/include")
_PCL: Final = ("segmentation", "octree", "search", "kdtree", "features", "filters", "common")
_PCL_OF_GEOGRASP: Final = (*_PCL, "visualization", "sample_consensus", "io")
_LCCP: Final = np.array([0.0075, 0.03, 10.0], np.float32)
"""Edge of a voxel [m], distance of seeds [m], concavity that is tolerated [deg]: the best of those tried on piles."""


def find_lccp() -> Callable[[Cloud, Int32], Int32] | None:
    """Return what splits the clusters of a cloud by local convexity; None where it cannot be compiled.

    Its arguments are an organised cloud and the (H, W) labels of clusters, from 1 on. It returns (H, W) labels of objects.
    """
    return _lccp if _can_compile() else None


def find_geograsp() -> Callable[[Cloud, Plane, float], Grasp] | None:
    """Return what plans a grasp; None where it cannot be compiled.

    Its arguments are the cloud of an object, the table and the size of a fingertip [mm].
    """
    return _geograsp if _can_compile() and _geograsp_source() and _newest("vtk") else None


def _lccp(cloud: Cloud, clusters: Int32) -> Int32:
    index = np.flatnonzero(clusters)
    xyz, given = cloud.xyz.reshape(-1, 3)[index], clusters.ravel()[index]
    found, image = np.zeros(len(index), np.int32), np.zeros(clusters.shape, np.int32)
    _call(_library("lccp", (), _PCL, ()).lccp, len(index), xyz, given.astype(np.int32), _LCCP, found)
    image.ravel()[index] = found
    return image


def _geograsp(cloud: Cloud, plane: Plane, tip_mm: float) -> Grasp:
    source, vtk = Path(str(_geograsp_source())), _newest("vtk")
    headers = (source / "geograsp/include", source / "geograsp/lib", _SYSTEM / vtk)
    others = ("-fopenmp", f"-lvtkCommonCore-{vtk.partition('-')[2]}", "-lboost_system")
    function = _library("geograsp", headers, _PCL_OF_GEOGRASP, others).geograsp
    found = np.empty((3, 3), np.float32)
    xyz, table = cloud.finite.astype(np.float32), np.array([*plane.normal, plane.offset], np.float32)
    _call(function, len(xyz), xyz, table, int(tip_mm), found)
    g1, g2, axis = found.astype(np.float64)
    return Grasp(g1, g2, hand_rotation(g1, g2, axis))


def _call(function: Any, *arguments: int | AnyArray) -> None:
    """Call a function of a library with numbers and contiguous arrays."""
    kept = [one if isinstance(one, int) else np.ascontiguousarray(one) for one in arguments]
    given = [ctypes.c_int32(one) if isinstance(one, int) else one.ctypes.data_as(ctypes.c_void_p) for one in kept]
    if function(*given):
        raise ForetouchError(f"{function.__name__}: PCL refused the cloud")


@lru_cache
def _library(name: str, headers: Sequence[Path], pcl: Sequence[str], others: Sequence[str]) -> ctypes.CDLL:
    """Return the compiled library of `<name>.cpp`; made once for each content of the file and each command."""
    source = Path(__file__).with_name(f"{name}.cpp")
    includes = [f"-I{path}" for path in (*headers, _SYSTEM / _newest("pcl"), _SYSTEM / "eigen3")]
    libraries = [*(f"-lpcl_{part}" for part in pcl), *others]
    command = ["g++", "-O3", "-std=c++17", "-shared", "-fPIC", "-w", *includes, str(source), *libraries]
    digest = hashlib.sha256(source.read_bytes() + " ".join(command).encode()).hexdigest()
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "foretouch" / "peers"
    built = folder / f"{name}-{digest[:16]}.so"
    if not built.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        fresh = built.with_suffix(f".{os.getpid()}")
        done = subprocess.run([*command, "-o", str(fresh)], check=False, capture_output=True, text=True)  # noqa: S603  own paths
        if done.returncode:
            reason = next((line for line in done.stderr.splitlines() if "error" in line), "no reason given")
            raise ForetouchError(f"{source.name}: cannot be compiled with {_newest('pcl')}: {shown(reason)}")
        fresh.replace(built)
    return ctypes.CDLL(str(built))


def _can_compile() -> bool:
    return bool(_newest("pcl")) and shutil.which("g++") is not None


def _geograsp_source() -> str:
    """Return the checkout of GeoGrasp; "" if none is named."""
    path = os.environ.get("FORETOUCH_GEOGRASP", "")
    if path and not (Path(path) / "geograsp/lib/geograsp/GeoGrasp.cpp").is_file():
        raise ConfigError(
            f"FORETOUCH_GEOGRASP: {path} holds no geograsp/lib/geograsp/GeoGrasp.cpp; name a checkout of GeoGrasp"
        )
    return path


def _newest(library: str) -> str:
    """Return the folder of the headers of a library; "" where it is not installed."""
    return max((path.name for path in _SYSTEM.glob(f"{library}-*")), default="")
