# SPDX-License-Identifier: Apache-2.0
"""Builds `moveit_task_constructor_msgs/SampleGraspPoses`, which no wheel of PyPI holds, in the way of `foretouch_msgs`.

    python test/planner_type_builder.py

builds it once (a minute, with a compiler and PyPI) into the user's cache, where the tests find it.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib import metadata
from pathlib import Path

PACKAGE = "moveit_task_constructor_msgs"
MESSAGES = Path(__file__).parents[1] / "foretouch_msgs"

# The fields of SampleGraspPoses.action of MoveIt Task Constructor (branch of the stage DeepGraspPose) and of dgl_ros.
ACTION = """\
string action_name
---
string grasp_state
---
geometry_msgs/PoseStamped[] grasp_candidates
float64[] costs
"""

CMAKE = f"""\
cmake_minimum_required(VERSION 3.20)
project({PACKAGE})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(action_msgs REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}} "action/SampleGraspPoses.action" DEPENDENCIES action_msgs geometry_msgs)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


_DISTRIBUTION = "jazzy" if metadata.version("ros-rclpy").startswith("7.") else "kilted"  # whose wheels run


def python_path(root: Path) -> Path:
    """Where Python finds the installed package."""
    return root / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"


def build() -> Path:
    """The folder that the package is installed into, built unless it is there; a RuntimeError with pip's last error."""
    texts = (ACTION, CMAKE, (MESSAGES / "pyproject.toml").read_text("utf-8"), sys.implementation.cache_tag or "")
    key = hashlib.sha256("\0".join((*texts, _DISTRIBUTION)).encode()).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    root = cache / "foretouch" / f"{PACKAGE}-{key}"
    if root.is_dir():
        return root
    with tempfile.TemporaryDirectory() as folder:
        source, wheels = _source(Path(folder) / PACKAGE), Path(folder) / "wheels"
        command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--retries", "0", "-w", wheels, source]
        environment = {k: v for k, v in os.environ.items() if k not in {"PYTHONPATH", "AMENT_PREFIX_PATH"}}
        environment |= {"FORETOUCH_ROS": _DISTRIBUTION, "PIP_DEFAULT_TIMEOUT": "15"}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        if done.returncode:
            lines = [line.strip() for line in done.stderr.splitlines() if "error:" in line.lower()]
            raise RuntimeError(f"{PACKAGE}: pip wheel: {lines[-1] if lines else done.returncode}")
        (wheel,) = wheels.glob("*.whl")
        unpacked = Path(folder) / "unpacked"
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(unpacked)
        (data,) = unpacked.glob("*.data/data")
        root.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(data, root.with_suffix(".part"), dirs_exist_ok=True)
    root.with_suffix(".part").rename(root)
    return root


def load(root: Path) -> None:
    """Load the package's libraries, which the linker then finds by their names in this process."""
    waiting = sorted((root / "lib").glob("*.so"))
    while waiting:
        left = [path for path in waiting if not _loads(path)]
        if len(left) == len(waiting):
            raise OSError(f"{left[0]}: cannot be loaded")
        waiting = left


def _loads(path: Path) -> bool:
    try:
        ctypes.CDLL(str(path))
    except OSError:
        return False
    return True


def _source(folder: Path) -> Path:
    (folder / "action").mkdir(parents=True)
    (folder / "action" / "SampleGraspPoses.action").write_text(ACTION, "utf-8")
    (folder / "CMakeLists.txt").write_text(CMAKE, "utf-8")
    for name in ("package.xml", "pyproject.toml"):
        text = (MESSAGES / name).read_text("utf-8").replace("foretouch_msgs", PACKAGE)
        (folder / name).write_text(text, "utf-8")
    shutil.copytree(MESSAGES / "pip", folder / "pip", ignore=shutil.ignore_patterns("__pycache__"))
    return folder


if __name__ == "__main__":
    sys.stdout.write(f"{build()}\n")
