# SPDX-License-Identifier: Apache-2.0
"""PEP 517 backend: scikit-build-core, with CMake pointed at the ROS 2 wheels of the build environment.

The hooks that only answer questions are scikit-build-core's own, with the packages of the chosen ROS 2 distribution
added; those that run CMake set its search path first.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from scikit_build_core import build as _scikit
from scikit_build_core.build import build_sdist, get_requires_for_build_sdist

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
]

_INCLUDE = Path(__file__).with_name("drop_missing_includes.cmake")


def get_requires_for_build_wheel(*args: Any, **kwargs: Any) -> list[str]:
    """What else the build needs (PEP 517). The wheels of ROS do not declare what building against them needs."""
    return [*_scikit.get_requires_for_build_wheel(*args, **kwargs), *_ros_packages()]


def get_requires_for_build_editable(*args: Any, **kwargs: Any) -> list[str]:
    """What else an editable build needs (PEP 660)."""
    return [*_scikit.get_requires_for_build_editable(*args, **kwargs), *_ros_packages()]


def build_wheel(*args: Any, **kwargs: Any) -> str:
    """Build a wheel (PEP 517)."""
    _point_cmake_at_wheels()
    return _scikit.build_wheel(*args, **kwargs)


def build_editable(*args: Any, **kwargs: Any) -> str:
    """Build an editable wheel (PEP 660); the generated code is copied all the same."""
    _point_cmake_at_wheels()
    return _scikit.build_editable(*args, **kwargs)


def _ros_packages() -> list[str]:
    distribution = os.environ.get("FORETOUCH_ROS", "jazzy")
    path = Path(__file__).with_name(f"ros_{distribution}.txt")
    if not path.is_file():
        raise RuntimeError(f"FORETOUCH_ROS: {distribution!r} is not jazzy or kilted")
    return path.read_text(encoding="utf-8").split()


def _point_cmake_at_wheels() -> None:
    prefix = str(_wheels_prefix())
    os.environ["AMENT_PREFIX_PATH"] = prefix
    os.environ["CMAKE_PREFIX_PATH"] = prefix
    given = os.environ.get("CMAKE_ARGS", "").split()
    ours = [f"-DCMAKE_PROJECT_INCLUDE={_INCLUDE}", f"-DPython3_EXECUTABLE={sys.executable}"]
    os.environ["CMAKE_ARGS"] = " ".join([*given, *(arg for arg in ours if arg not in given)])


def _wheels_prefix() -> Path:
    """The prefix that holds ament_cmake: pip's isolated environment, or the active one."""
    import ament_package

    for folder in Path(ament_package.__file__).resolve().parents:
        if (folder / "share" / "ament_cmake" / "cmake").is_dir():
            return folder
    raise RuntimeError("ros-ament-cmake: not installed beside ros-ament-package")
