# SPDX-License-Identifier: Apache-2.0
"""The whole graph on a simulated scene, whose camera and hand replace the real ones.

ros2 launch foretouch scene.launch.py
ros2 launch foretouch scene.launch.py scene:=deformables.yaml dwell:=10
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

sys.path.append(str(Path(__file__).resolve().parent))
from foretouch_launch_helpers import (
    SHARE,
    argument_values,
    arguments_are_checked,
    foretouch_node,
    include_perception,
    shared_arguments,
)

ARGUMENTS = [
    DeclareLaunchArgument(
        "scene",
        default_value=PathJoinSubstitution([SHARE, "config", "scenes", "demo.yaml"]),
        description="Scene file (YAML)",
    ),
    DeclareLaunchArgument("dwell", default_value="3.0", description="Time that each object stays on the table [s]"),
    DeclareLaunchArgument("fps", default_value="5", description="Frame rate of the camera [Hz]"),
    *shared_arguments(),
]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [*ARGUMENTS, arguments_are_checked(), include_perception(), OpaqueFunction(function=scene)]
    )


def scene(context: LaunchContext) -> list[Node]:
    given = argument_values(context, "scene", "dwell", "fps")
    shown = ["-p", f"scene.path:={given['scene']}", "-p", f"scene.dwell_s:={float(given['dwell'])}"]
    options = {"hand": shown, "camera": [*shown, "-p", "source:=scene", "-p", f"camera.fps:={given['fps']}"]}
    return [foretouch_node(context, name, ros_arguments=arguments) for name, arguments in options.items()]
