# SPDX-License-Identifier: Apache-2.0
"""The recorder alone, beside a running graph: touches paired with grasps, into a dataset.

ros2 launch foretouch recorder.launch.py record:=/data/session object:=can
ros2 launch foretouch recorder.launch.py folder:=/data tactile:=/rh/tactile tactile_type:=sr_robot_msgs/BiotacAll
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PARAMETERS = {  # by argument
    "record": "record",
    "object": "object",
    "folder": "folder",
    "tactile": "tactile_topic",
    "tactile_type": "tactile.type",
}
ARGUMENTS = [
    DeclareLaunchArgument(
        "record", default_value="", description="Dataset to record into; else start_recording begins"
    ),
    DeclareLaunchArgument("object", default_value="", description="Label of what lies on the table, for record"),
    DeclareLaunchArgument("folder", default_value="", description="Where recordings with a relative path go"),
    DeclareLaunchArgument("tactile", default_value="", description="Topic of the hand, if not /rh/tactile"),
    DeclareLaunchArgument("tactile_type", default_value="", description="Its type, if not foretouch_msgs/BiotacAll"),
    DeclareLaunchArgument("namespace", default_value="/foretouch", description="Of the graph"),
    DeclareLaunchArgument("params_file", default_value="", description="ROS parameters, YAML"),
]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=recorder)])


def recorder(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in (*PARAMETERS, "params_file")}
    said = {parameter: given[name] for name, parameter in PARAMETERS.items() if given[name]}  # as texts, even "7"
    return [
        Node(
            package="foretouch",
            executable="foretouch_recorder",
            namespace=LaunchConfiguration("namespace"),
            parameters=[*filter(None, [given["params_file"]]), said],
            output="screen",
        )
    ]
