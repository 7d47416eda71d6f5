# SPDX-License-Identifier: Apache-2.0
"""Play a recording or a folder of clouds through the whole graph; ends when everything was played.

ros2 launch foretouch replay.launch.py path:=recording/
"""

import sys
from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

sys.path.append(str(Path(__file__).resolve().parent))
from foretouch_launch_helpers import arguments_are_checked, foretouch_node, include_perception, shared_arguments

ARGUMENTS = [
    DeclareLaunchArgument("path", description="Recording, cloud file, or folder of clouds or samples"),
    *shared_arguments(),
]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [*ARGUMENTS, arguments_are_checked(), OpaqueFunction(function=perception), OpaqueFunction(function=replay)]
    )


def perception(context: LaunchContext) -> list[Any]:
    """Include perception with the input that the path holds: whole scenes, or objects that are cut out already."""
    from foretouch.dataset.source import open_source
    from foretouch.ros.sessions.playlist import cloud_is_object

    source = open_source(LaunchConfiguration("path").perform(context))
    if source.info_topic:
        return [include_perception(input="depth", depth=source.topic, color=source.color_topic)]
    return [include_perception(input="objects" if cloud_is_object(source) else "points")]


def replay(context: LaunchContext) -> list[Node]:
    path = ["-p", ["path:=", LaunchConfiguration("path")]]
    return [foretouch_node(context, "replay", ros_arguments=path)]
