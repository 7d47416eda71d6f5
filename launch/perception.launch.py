# SPDX-License-Identifier: Apache-2.0
"""The whole chain: camera (unless the site has its own), segmentation, grasp, touch predictor, RViz if wanted.

ros2 launch foretouch perception.launch.py
ros2 launch foretouch perception.launch.py camera:=false points:=/camera/camera/depth/color/points rviz:=true
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

SHARE = FindPackageShare("foretouch")
MODEL_USERS = ("perception", "touch_predictor")
ARGUMENTS = [
    DeclareLaunchArgument("namespace", default_value="/foretouch", description="Of all nodes"),
    DeclareLaunchArgument("camera", default_value="true", description="false where realsense2_camera publishes"),
    DeclareLaunchArgument("points", default_value="points", description="Topic of the depth clouds"),
    DeclareLaunchArgument("model", default_value="default", description="Name of a shipped model, or a checkpoint"),
    DeclareLaunchArgument("params_file", default_value="", description="ROS parameters of any node, YAML"),
    DeclareLaunchArgument("one_process", default_value="true", description="false: a process for each node"),
    DeclareLaunchArgument("rviz", default_value="false", description="Whether to start RViz"),
]


def generate_launch_description() -> LaunchDescription:
    camera = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([SHARE, "launch", "camera.launch.py"])),
        launch_arguments={name: LaunchConfiguration(name) for name in ("namespace", "params_file")}.items(),
        condition=IfCondition(LaunchConfiguration("camera")),
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", PathJoinSubstitution([SHARE, "config", "foretouch.rviz"])],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription([*ARGUMENTS, camera, OpaqueFunction(function=perception), rviz])


def perception(context: LaunchContext) -> list[Node]:
    given = {
        name: LaunchConfiguration(name).perform(context) for name in ("namespace", "points", "model", "params_file")
    }
    together = IfCondition(LaunchConfiguration("one_process")).evaluate(context)
    executables = ["perception"] if together else ["segmentation", "grasp", "touch_predictor"]
    return [
        Node(
            package="foretouch",
            executable=f"foretouch_{executable}",
            namespace=given["namespace"],
            remappings=[("points", given["points"])],
            parameters=[given["params_file"]] if given["params_file"] else [],
            ros_arguments=["-p", f"model:={given['model']}"] if executable in MODEL_USERS else [],
            output="screen",
        )
        for executable in executables
    ]
