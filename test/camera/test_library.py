# SPDX-License-Identifier: Apache-2.0
"""Beside ROS, the process must end cleanly: tried in a fresh interpreter."""

from __future__ import annotations

import subprocess
import sys

import pytest

_SCRIPT = """
import sys
{first}
from foretouch.camera.device import realsense
rs = realsense()
names = list(sys.modules)
assert names.index("rclpy") < names.index("pyrealsense2")
import rclpy
rclpy.init(); rclpy.create_node("probe").destroy_node(); rclpy.shutdown()
print(rs.software_device() is not None)
"""


@pytest.mark.parametrize("first", ["", "import rclpy"])
def test_rclpy_is_imported_before_pyrealsense2_and_the_process_ends_cleanly(first: str) -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("foretouch.camera.device").realsense()
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT.format(first=first)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, "True"), done.stderr


def test_the_package_imports_neither_ros_nor_the_library() -> None:
    script = (
        "import sys, foretouch.camera, foretouch.simulation\n"
        "print([m for m in ('rclpy', 'pyrealsense2', 'scipy', 'open3d') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"
