# SPDX-License-Identifier: Apache-2.0
"""A recording, or a folder of clouds, through the whole chain; ends when it has been played.

ros2 launch foretouch replay.launch.py path:=recording/
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

PASSED_ON = ("namespace", "model", "params_file", "rviz")
ARGUMENTS = [
    DeclareLaunchArgument("path", description="Recording, cloud file, or folder of clouds or samples"),
    DeclareLaunchArgument("namespace", default_value="/foretouch", description="Of all nodes"),
    DeclareLaunchArgument("model", default_value="default", description="Name of a shipped model, or a checkpoint"),
    DeclareLaunchArgument("params_file", default_value="", description="ROS parameters of any node, YAML"),
    DeclareLaunchArgument("rviz", default_value="false", description="Whether to start RViz"),
]


def generate_launch_description() -> LaunchDescription:
    perception = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([FindPackageShare("foretouch"), "launch", "perception.launch.py"])
        ),
        launch_arguments={"camera": "false", **{name: LaunchConfiguration(name) for name in PASSED_ON}}.items(),
    )
    return LaunchDescription([*ARGUMENTS, perception, OpaqueFunction(function=replay)])


def replay(context: LaunchContext) -> list[Node]:
    params_file = LaunchConfiguration("params_file").perform(context)
    return [
        Node(
            package="foretouch",
            executable="foretouch_replay",
            namespace=LaunchConfiguration("namespace"),
            parameters=[params_file] if params_file else [],
            ros_arguments=["-p", ["path:=", LaunchConfiguration("path")]],
            output="screen",
            on_exit=Shutdown(reason="the source has been played"),
        )
    ]
