# SPDX-License-Identifier: Apache-2.0
"""The RealSense camera alone: publishes `points` in the namespace.

ros2 launch foretouch camera.launch.py params_file:=d415.yaml
"""

import sys
from pathlib import Path

from launch.actions import OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

sys.path.append(str(Path(__file__).resolve().parent))
from foretouch_launch_helpers import arguments_are_checked, foretouch_node, shared_arguments

ARGUMENTS = shared_arguments(graph=False)


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, arguments_are_checked(), OpaqueFunction(function=camera)])


def camera(context: LaunchContext) -> list[Node]:
    return [foretouch_node(context, "camera")]
