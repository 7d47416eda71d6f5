# SPDX-License-Identifier: Apache-2.0
"""The RealSense alone: `points` under the namespace.

ros2 launch foretouch camera.launch.py params_file:=d415.yaml
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

ARGUMENTS = [
    DeclareLaunchArgument("namespace", default_value="/foretouch", description="Of the node"),
    DeclareLaunchArgument("params_file", default_value="", description="ROS parameters, YAML"),
]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=camera)])


def camera(context: LaunchContext) -> list[Node]:
    params_file = LaunchConfiguration("params_file").perform(context)
    return [
        Node(
            package="foretouch",
            executable="foretouch_camera",
            namespace=LaunchConfiguration("namespace"),
            parameters=[params_file] if params_file else [],
            output="screen",
        )
    ]
