# SPDX-License-Identifier: Apache-2.0
"""A launch file started by `launch` itself: the graph answers, and ends without an error."""

import inspect
import os
import sys
import time
from pathlib import Path

import pytest

for name in ("launch", "launch_ros.actions", "launch_pytest"):
    pytest.importorskip(name, reason=f"{name.partition('.')[0]} comes with a full ROS 2 install only")

import launch_pytest  # noqa: E402
import launch_pytest.plugin  # noqa: E402
import rclpy  # noqa: E402
from launch.actions import IncludeLaunchDescription  # noqa: E402
from launch.launch_description_sources import PythonLaunchDescriptionSource  # noqa: E402

from foretouch.ros.executables import EXECUTABLES  # noqa: E402
from foretouch_msgs.msg import Status, TouchPredictionArray  # noqa: E402
from launch import LaunchDescription  # noqa: E402
from test.ros.conftest import open_domain  # noqa: E402

if pytest.version_tuple >= (8, 4) and "_pytestfixturefunction" in inspect.getsource(launch_pytest.plugin):
    pytest.skip("this launch_pytest needs a pytest before 8.4, such as that of Ubuntu 24.04", allow_module_level=True)

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.ros, pytest.mark.slow]
CLOUDS = 3


def installed(prefix: Path) -> None:
    """What `colcon build` installs of the package, in a prefix: the files of `share`, and an executable for each node."""
    (prefix / "share" / "ament_index" / "resource_index" / "packages").mkdir(parents=True)
    (prefix / "share" / "ament_index" / "resource_index" / "packages" / "foretouch").touch()
    (prefix / "share" / "foretouch").symlink_to(ROOT)
    (prefix / "lib" / "foretouch").mkdir(parents=True)
    for executable in EXECUTABLES:
        path = prefix / "lib" / "foretouch" / f"foretouch_{executable}"
        path.write_text(f"#!{sys.executable}\nfrom foretouch.ros.executables import run, EXECUTABLES\n"
                        f"raise SystemExit(run(*EXECUTABLES[{executable!r}]))\n", encoding="utf-8")  # fmt: skip
        path.chmod(0o755)


@launch_pytest.fixture
def description(tmp_path, monkeypatch):
    """`scene.launch.py` with a scene of the examples, in a domain of its own."""
    installed(tmp_path / "prefix")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(open_domain(new=True)))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'prefix'}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    source = PythonLaunchDescriptionSource(str(ROOT / "launch" / "scene.launch.py"))
    arguments = {"scene": str(ROOT / "examples" / "data" / "table.yaml"), "fps": "2"}
    return LaunchDescription(
        [IncludeLaunchDescription(source, launch_arguments=arguments.items()), launch_pytest.actions.ReadyToTest()]
    )


@pytest.mark.launch(fixture=description)
def test_the_launched_graph_answers_clouds_and_ends_without_an_error():
    node, heard = rclpy.create_node("listener", namespace="/foretouch"), []
    node.create_subscription(TouchPredictionArray, "touch", heard.append, 10)
    end = time.monotonic() + 60.0
    while len(heard) < CLOUDS and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.2)
    node.destroy_node()
    assert len(heard) >= CLOUDS, "no answer within 60 s"
    assert {one.status for one in heard} <= {Status.OK, Status.INITIAL_POINTS}
    assert all(one.predictions for one in heard)
