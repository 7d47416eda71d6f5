# SPDX-License-Identifier: Apache-2.0
"""What the launch files of foretouch share. It is installed beside them and found through their folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext

SHARE = FindPackageShare("foretouch")
_NODE = ("namespace", "params_file", "use_sim_time", "respawn")  # what every node takes
_ARGUMENTS = {  # default and description
    "namespace": ("/foretouch", "Namespace of all nodes"),
    "model": (
        "default",
        "Name of a model, or path of its card, weights or model folder; networks are joined by commas",
    ),
    "predictor": ("", "Predictor of a model of your own: module:attribute, or an entry point of foretouch.models"),
    "params_file": ("", "ROS parameter file (YAML) for any of the nodes"),
    "use_sim_time": ("false", "Whether the time is that of /clock, as with a simulator or a bag that is played"),
    "respawn": ("false", "Whether a node that ends is started again after 2 s; else the launch ends with it"),
    "rviz": ("false", "Whether to start RViz"),
}


def shared_arguments(*, graph: bool = True) -> list[DeclareLaunchArgument]:
    """Declare arguments that several launch files have: those of every node, and with `graph` those of the whole graph."""
    return [
        DeclareLaunchArgument(name, default_value=_ARGUMENTS[name][0], description=_ARGUMENTS[name][1])
        for name in (_ARGUMENTS if graph else _NODE)
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
    if "rviz" in given and is_set(context, "rviz"):
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


def is_set(context: LaunchContext, name: str) -> bool:
    """Return whether a launch argument is true."""
    return bool(IfCondition(LaunchConfiguration(name)).evaluate(context))


def foretouch_node(
    context: LaunchContext, name: str, parameters: Mapping[str, str] | None = None, **options: Any
) -> Node:
    """Describe one node of foretouch with what all launch files take: namespace, parameter file, clock and respawn.

    Without respawn the launch ends with the node: the others are of no use alone.

    Args:
        context: Holds the arguments.
        name: Of the executable, without `foretouch_`.
        parameters: Set beside the parameters of the file, and stronger.
        options: For `launch_ros.actions.Node`.
    """
    params_file = argument_values(context, "params_file")["params_file"]
    given = [params_file, *([{"use_sim_time": True}] if is_set(context, "use_sim_time") else []), parameters]
    again = is_set(context, "respawn") and name != "replay"  # which ends once everything was played
    ends = {"respawn": True, "respawn_delay": 2.0} if again else {"on_exit": end_with_node}
    return Node(
        package="foretouch",
        executable=f"foretouch_{name}",
        namespace=LaunchConfiguration("namespace"),
        parameters=[each for each in given if each],
        output="screen",
        **ends,
        **options,
    )


def include(name: str, *, graph: bool, condition: Any = None, **fixed: str) -> IncludeLaunchDescription:
    """Include another launch file of foretouch, with the arguments that both have.

    Args:
        name: Of the file, without `.launch.py`.
        graph: Whether both have the arguments of the whole graph.
        condition: Under which it is included; None for always.
        fixed: Values of further arguments.
    """
    arguments = {**fixed, **{argument: LaunchConfiguration(argument) for argument in (_ARGUMENTS if graph else _NODE)}}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([SHARE, "launch", f"{name}.launch.py"])),
        launch_arguments=arguments.items(),
        condition=condition,
    )


def include_perception(**fixed: str) -> IncludeLaunchDescription:
    """Include perception, with values of its arguments, for launch files that bring their own source of clouds."""
    return include("perception", graph=True, camera="false", **fixed)
