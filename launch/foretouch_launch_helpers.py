# SPDX-License-Identifier: Apache-2.0
"""What the launch files of foretouch share. It is installed beside them and found through their folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext

SHARE = FindPackageShare("foretouch")
_ARGUMENTS = {  # default and description
    "namespace": ("/foretouch", "Namespace of all nodes"),
    "model": (
        "default",
        "Name of a model, or path of its card, weights or model folder; networks are joined by commas",
    ),
    "predictor": ("", "Predictor of a model of your own: module:attribute, or an entry point of foretouch.models"),
    "params_file": ("", "ROS parameter file (YAML) for any of the nodes"),
    "rviz": ("false", "Whether to start RViz"),
}


def shared_arguments(*names: str) -> list[DeclareLaunchArgument]:
    """Declare arguments that several launch files have: all of them, or those named."""
    return [
        DeclareLaunchArgument(name, default_value=_ARGUMENTS[name][0], description=_ARGUMENTS[name][1])
        for name in names or _ARGUMENTS
    ]


def arguments_are_checked() -> OpaqueFunction:
    """Check the values of all arguments; must come before anything that starts a process.

    After an error, launch ends with exit status 1, but forgets the processes of the same launch file: they would stay.
    """
    return OpaqueFunction(function=_check_arguments)


def _check_arguments(context: LaunchContext) -> None:
    given = context.launch_configurations
    for name in ("params_file", "path", "scene"):
        if given.get(name) and not Path(given[name]).exists():
            raise RuntimeError(f"{name}: {given[name]} does not exist")
    if given.get("rviz", "false").lower() in {"true", "1"}:
        try:
            get_package_prefix("rviz2")
        except PackageNotFoundError as err:
            raise RuntimeError("rviz: the package rviz2 is not installed; install it, or leave rviz:=true out") from err
    if given.get("model", "default") != "default":
        _check_model(given["model"])


def _check_model(name: str) -> None:
    try:
        from foretouch.models.card import read_card
        from foretouch.models.registry import find_cards
    except ImportError:  # what the nodes need may be in an environment of their own
        return
    for path in find_cards(name):
        read_card(path)


def end_with_node(event: Any, context: LaunchContext) -> Shutdown:
    """End the launch with a process; if that failed, with exit status 1."""
    if event.returncode and not context.is_shutdown:
        raise RuntimeError(f"{event.process_name} ended with exit status {event.returncode}")
    return Shutdown(reason=f"{event.process_name} has ended")


def argument_values(context: LaunchContext, *names: str) -> dict[str, str]:
    """Return the values of launch arguments by name."""
    return {name: LaunchConfiguration(name).perform(context) for name in names}


def foretouch_node(
    context: LaunchContext, name: str, parameters: Mapping[str, str] | None = None, **options: Any
) -> Node:
    """Describe one node of foretouch with the namespace and the parameter file of the launch arguments.

    The launch ends with it: the others are of no use alone.

    Args:
        context: Holds the arguments.
        name: Of the executable, without `foretouch_`.
        parameters: Set beside the parameters of the file, and stronger.
        options: For `launch_ros.actions.Node`.
    """
    params_file = argument_values(context, "params_file")["params_file"]
    return Node(
        package="foretouch",
        executable=f"foretouch_{name}",
        namespace=LaunchConfiguration("namespace"),
        parameters=[*filter(None, [params_file]), *([] if parameters is None else [parameters])],
        output="screen",
        on_exit=end_with_node,
        **options,
    )


def include(name: str, *passed_on: str, condition: Any = None, **fixed: str) -> IncludeLaunchDescription:
    """Include another launch file of foretouch.

    Args:
        name: Of the file, without `.launch.py`.
        passed_on: Arguments that both files have.
        condition: Under which it is included; None for always.
        fixed: Values of further arguments.
    """
    arguments = {**fixed, **{argument: LaunchConfiguration(argument) for argument in passed_on}}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([SHARE, "launch", f"{name}.launch.py"])),
        launch_arguments=arguments.items(),
        condition=condition,
    )


def include_perception(**fixed: str) -> IncludeLaunchDescription:
    """Include perception, with values of its arguments, for launch files that bring their own source of clouds."""
    return include("perception", *_ARGUMENTS, camera="false", **fixed)
