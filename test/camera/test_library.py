# SPDX-License-Identifier: Apache-2.0
"""Beside ROS, the process must end cleanly: tried in a fresh interpreter."""

import pytest
from command_answer import run_python

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


def _printed(script: str) -> str:
    done = run_python(script)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_rclpy_is_imported_before_pyrealsense2_and_the_process_ends_cleanly() -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("foretouch.camera.device").realsense()
    assert [_printed(_SCRIPT.format(first=first)) for first in ("", "import rclpy")] == ["True", "True"]


def test_the_package_imports_neither_ros_nor_the_library() -> None:
    names = "('rclpy', 'pyrealsense2', 'scipy', 'open3d')"
    script = f"import sys, foretouch.camera, foretouch_lab.simulation; print([m for m in {names} if m in sys.modules])"
    assert _printed(script) == "[]"
