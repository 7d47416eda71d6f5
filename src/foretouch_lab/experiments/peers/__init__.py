# SPDX-License-Identifier: Apache-2.0
"""Programs of others in C++, called in this process, so that their times compare: PCL's LCCP and the published GeoGrasp.

Each is compiled when it is first used, where g++ and PCL are installed (`apt install g++ libpcl-dev`). GeoGrasp also needs a
checkout of its source, https://github.com/yayaneath/GeoGrasp, whose path is in the environment variable `FORETOUCH_GEOGRASP`.
`FORETOUCH_PEERS=0` leaves both out.
"""

import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from cffi import FFI

from foretouch.base.files import cache_folder, file_sha256
from foretouch.errors import ConfigError, ForetouchError, described, shown
from foretouch.grasp import hand_rotation
from foretouch.types import AnyArray, Cloud, Grasp, Int32, Plane

_CHECKOUT: Final = "FORETOUCH_GEOGRASP"
_GEOGRASP: Final = "geograsp/lib/geograsp/GeoGrasp.cpp"  # in the checkout
_SWITCH: Final = "FORETOUCH_PEERS"
_WITHOUT: Final = f"; {_SWITCH}=0 leaves such peers out"
_SYSTEM: Final = Path("/usr/include")
_PCL: Final = ("segmentation", "octree", "search", "kdtree", "features", "filters", "common")
_PCL_OF_GEOGRASP: Final = (*_PCL, "visualization", "sample_consensus", "io")
_INTERFACE: Final = FFI()
_INTERFACE.cdef("""
    int lccp(int32_t n, const float *xyz, const int32_t *clusters, const float *settings, int32_t *labels);
    int geograsp(int32_t n, const float *xyz, const float *plane, int32_t tip_mm, float *found);
""")
_LCCP: Final = np.array([0.0075, 0.03, 10.0], np.float32)
"""Edge of a voxel [m], distance of seeds [m], concavity that is tolerated [deg]: the best of those tried on piles."""


def has_lccp() -> bool:
    """Return whether there is what LCCP is compiled with."""
    return os.environ.get(_SWITCH) != "0" and bool(_newest("pcl")) and shutil.which("g++") is not None


def lccp(cloud: Cloud, clusters: Int32) -> Int32:
    """Split the clusters of a cloud by local convexity.

    Args:
        cloud: Organised.
        clusters: (H, W) labels, from 1 on.

    Returns:
        (H, W) labels of objects, from 1 on.
    """
    xyz = cloud.xyz.reshape(-1, 3)
    index = np.flatnonzero((clusters.ravel() > 0) & np.isfinite(xyz).all(axis=1))
    found, image = np.zeros(len(index), np.int32), np.zeros(clusters.shape, np.int32)
    if len(index):
        library = _library("lccp", (), _PCL, ())
        given = xyz[index].astype(np.float32), clusters.ravel()[index].astype(np.int32), _LCCP
        _call(library, "lccp", len(index), *given, found)
    image.ravel()[index] = found
    return image


def has_geograsp() -> bool:
    """Return whether there is what GeoGrasp is compiled with, and its source."""
    checkout = _checkout()
    return has_lccp() and bool(_newest("vtk")) and checkout is not None and (checkout / _GEOGRASP).is_file()


def check_geograsp() -> None:
    """Raise a `ConfigError` if `FORETOUCH_GEOGRASP` names another folder than a checkout of GeoGrasp."""
    if (checkout := _checkout()) is not None and not (checkout / _GEOGRASP).is_file():
        raise ConfigError(f"{_CHECKOUT}: {checkout / _GEOGRASP}: no such file; name a checkout of GeoGrasp")


def geograsp(cloud: Cloud, plane: Plane, tip_mm: float) -> Grasp | None:
    """Plan a grasp as the published GeoGrasp does; None if it finds none.

    Args:
        cloud: Of an object.
        plane: The table.
        tip_mm: Size of a fingertip [mm].
    """
    checkout, vtk = _checkout(), _newest("vtk")
    if checkout is None:
        raise ConfigError(f"{_CHECKOUT}: is not set; name a checkout of GeoGrasp")
    headers = (checkout / "geograsp/include", checkout / "geograsp/lib", _SYSTEM / vtk)
    others = ("-fopenmp", f"-lvtkCommonCore-{vtk.partition('-')[2]}", "-lboost_system")
    found = np.zeros((3, 3), np.float32)
    xyz, table = cloud.finite.astype(np.float32), np.array([*plane.normal, plane.offset], np.float32)
    _call(_library("geograsp", headers, _PCL_OF_GEOGRASP, others), "geograsp", len(xyz), xyz, table, int(tip_mm), found)
    g1, g2, axis = found.astype(np.float64)
    return None if np.array_equal(g1, g2) else Grasp(g1, g2, hand_rotation(g1, g2, axis))


def _call(library: Any, name: str, *arguments: int | AnyArray) -> None:
    """Call a function of a library with numbers and contiguous arrays of float32 or int32."""
    types = {np.dtype(np.float32): "float[]", np.dtype(np.int32): "int32_t[]"}
    if getattr(library, name)(
        *(one if isinstance(one, int) else _INTERFACE.from_buffer(types[one.dtype], one) for one in arguments)
    ):
        raise ForetouchError(f"{name}: PCL refused the cloud")


@lru_cache
def _library(name: str, headers: Sequence[Path], pcl: Sequence[str], others: Sequence[str]) -> Any:
    """Return the compiled library of `<name>.cpp`; made once for each content of the sources and each command."""
    source = Path(__file__).with_name(f"{name}.cpp")
    read = [source, *(file for folder in headers[:2] for file in sorted(folder.rglob("*.[ch]*")))]
    includes = [f"-I{path}" for path in (*headers, _SYSTEM / _newest("pcl"), _SYSTEM / "eigen3")]
    libraries = [*(f"-lpcl_{part}" for part in pcl), *others]
    command = ["g++", "-O3", "-std=c++17", "-shared", "-fPIC", "-w", *includes, str(source), *libraries]
    digest = hashlib.sha256(" ".join([*command, *map(file_sha256, read)]).encode()).hexdigest()
    built = Path(f"{name}-{digest[:16]}.so")
    try:
        built = cache_folder("peers") / built
        if not built.is_file():
            fresh = built.with_suffix(f".{os.getpid()}")
            done = subprocess.run([*command, "-o", str(fresh)], check=False, capture_output=True, text=True)  # noqa: S603
            if done.returncode:
                reason = next((line for line in done.stderr.splitlines() if "error" in line), "no reason given")
                raise ForetouchError(
                    f"{source.name}: cannot be compiled with {_newest('pcl')}: {shown(reason)}{_WITHOUT}"
                )
            fresh.replace(built)
        return _INTERFACE.dlopen(str(built))
    except OSError as err:
        raise ForetouchError(f"{built}: {described(err)}; remove it and repeat{_WITHOUT}") from err


def _checkout() -> Path | None:
    """Return the checkout of GeoGrasp that the user names; None if none is named."""
    path = os.environ.get(_CHECKOUT)
    return Path(path).resolve() if path else None


def _newest(library: str) -> str:
    """Return the folder of the headers of a library; "" where it is not installed."""
    return max((path.name for path in _SYSTEM.glob(f"{library}-*")), default="")
