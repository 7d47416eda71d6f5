# SPDX-License-Identifier: Apache-2.0
"""The recorder alone, beside a running graph: records grasps and tactile readings to a dataset.

ros2 launch foretouch recorder.launch.py record:=/data/session object:=can
ros2 launch foretouch recorder.launch.py folder:=/data tactile:=/rh/tactile tactile_type:=sr_robot_msgs/BiotacAll
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

sys.path.append(str(Path(__file__).resolve().parent))
from foretouch_launch_helpers import argument_values, arguments_are_checked, foretouch_node, shared_arguments

PARAMETERS = {  # by argument
    "record": "record",
    "object": "object",
    "folder": "folder",
    "tactile": "tactile_topic",
    "tactile_type": "tactile.type",
}
DESCRIPTIONS = {
    "record": "Dataset to record to; if empty, the service start_recording starts a recording",
    "object": "Label of the object on the table, for `record`",
    "folder": "Folder of recordings that are given by a relative path",
    "tactile": "Topic of the tactile messages, if not the default",
    "tactile_type": "Type of the tactile messages, if not foretouch_msgs/BiotacAll",
}
ARGUMENTS = [
    *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in DESCRIPTIONS.items()),
    *shared_arguments(graph=False),
]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, arguments_are_checked(), OpaqueFunction(function=recorder)])


def recorder(context: LaunchContext) -> list[Node]:
    given = argument_values(context, *PARAMETERS)
    # Passed as strings, so that an object named 7 stays one.
    parameters = {parameter: given[name] for name, parameter in PARAMETERS.items() if given[name]}
    return [foretouch_node(context, "recorder", parameters)]
