# SPDX-License-Identifier: Apache-2.0
"""The whole chain on a simulated scene: its camera and its hand in place of the real ones.

ros2 launch foretouch scene.launch.py scene:=deformables.yaml
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

PASSED_ON = ("namespace", "model", "params_file", "rviz")
ARGUMENTS = [
    DeclareLaunchArgument("scene", description="Scene file, YAML"),
    DeclareLaunchArgument("dwell", default_value="3.0", description="Seconds that each object lies on the table"),
    DeclareLaunchArgument("fps", default_value="5", description="Images a second"),
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
    return LaunchDescription([*ARGUMENTS, perception, OpaqueFunction(function=scene)])


def scene(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ("scene", "dwell", "fps", "params_file")}
    shown = ["-p", f"scene.path:={given['scene']}", "-p", f"scene.dwell_s:={float(given['dwell'])}"]
    options = {"hand": shown, "camera": [*shown, "-p", "source:=scene", "-p", f"camera.fps:={given['fps']}"]}
    return [
        Node(
            package="foretouch",
            executable=f"foretouch_{name}",
            namespace=LaunchConfiguration("namespace"),
            parameters=[given["params_file"]] if given["params_file"] else [],
            ros_arguments=arguments,
            output="screen",
        )
        for name, arguments in options.items()
    ]
