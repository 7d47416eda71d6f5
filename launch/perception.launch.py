# SPDX-License-Identifier: Apache-2.0
"""The whole graph: camera (unless the robot has its own), perception, and RViz on request.

ros2 launch foretouch perception.launch.py
ros2 launch foretouch perception.launch.py camera:=false depth:=/camera/camera/depth/image_rect_raw rviz:=true
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

sys.path.append(str(Path(__file__).resolve().parent))
from foretouch_launch_helpers import (
    SHARE,
    argument_values,
    arguments_are_checked,
    foretouch_node,
    include,
    is_set,
    shared_arguments,
)

CAMERA_USERS = ("perception", "segmentation")
MODEL_USERS = ("perception", "touch_predictor")
ARGUMENTS = [
    DeclareLaunchArgument("camera", default_value="true", description="false where realsense2_camera publishes"),
    DeclareLaunchArgument("depth", default_value="depth/image_rect_raw", description="Topic of the depth images"),
    DeclareLaunchArgument(
        "color", default_value="", description="Topic of the colours of their pixels, aligned with them"
    ),
    DeclareLaunchArgument("points", default_value="", description="Topic of its clouds, to use them instead"),
    DeclareLaunchArgument(
        "one_process", default_value="true", description="false: a process for each step, to replace one of them"
    ),
    DeclareLaunchArgument(
        "input", default_value="", description="objects: object_cloud and table come from who segments"
    ),
    *shared_arguments(),
]


def generate_launch_description() -> LaunchDescription:
    camera = include("camera", graph=False, condition=IfCondition(LaunchConfiguration("camera")))
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", PathJoinSubstitution([SHARE, "config", "foretouch.rviz"])],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription([*ARGUMENTS, arguments_are_checked(), camera, OpaqueFunction(function=perception), rviz])


def perception(context: LaunchContext) -> list[Node]:
    given = argument_values(context, "depth", "color", "points", "model", "predictor", "input")
    kind = given["input"] or ("points" if given["points"] else "depth")
    topics = {"depth/image": "depth", "color/image": "color", "points": "points"}
    remapped = [(name, given[topic]) for name, topic in topics.items() if given[topic]]
    return [
        foretouch_node(
            context,
            name,
            remappings=remapped,
            ros_arguments=[
                *(["-p", f"model:={given['model']}"] if name in MODEL_USERS else []),
                *(["-p", f"predictor:={given['predictor']}"] if name in MODEL_USERS and given["predictor"] else []),
                *(["-p", f"input:={kind}"] if name in CAMERA_USERS else []),
            ],
        )
        for name in (["perception"] if is_set(context, "one_process") else ["segmentation", "grasp", "touch_predictor"])
    ]
