# SPDX-License-Identifier: Apache-2.0
"""One `main` a node, and `perception` for segmentation, grasp and touch predictor in one process.

Threads: one executor thread delivers messages, and every node does its slow work in threads of its own (see
`worker` for topics and `offload` for services and actions), so that a cloud in work delays neither the next one
nor a service, a parameter or a lifecycle request. NumPy, SciPy and torch release the interpreter's lock while they compute, so the
three nodes of `perception` do work at the same time. `ros2 run` and the launch files start these.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from types import FrameType
from typing import TYPE_CHECKING, Any

from foretouch.errors import ForetouchError
from foretouch.ros.runtime.environment import prepare_environment

if TYPE_CHECKING:
    from foretouch.ros.runtime.lifecycle_node import ForetouchNode

__all__ = [
    "PERCEPTION",
    "camera",
    "grasp",
    "hand",
    "make_nodes",
    "perception",
    "recorder",
    "replay",
    "run",
    "segmentation",
    "spin",
    "touch_predictor",
]

_CLASSES = {
    "camera": ("foretouch.ros.nodes.camera", "CameraNode"),
    "segmentation": ("foretouch.ros.nodes.segmentation", "SegmentationNode"),
    "grasp": ("foretouch.ros.nodes.grasp", "GraspNode"),
    "touch_predictor": ("foretouch.ros.nodes.touch_predictor", "TouchPredictorNode"),
    "replay": ("foretouch.ros.nodes.replay", "ReplayNode"),
    "hand": ("foretouch.ros.nodes.hand", "HandNode"),
    "recorder": ("foretouch.ros.nodes.recorder", "RecorderNode"),
}
PERCEPTION = ("segmentation", "grasp", "touch_predictor")
_POLL_S = 0.2  # between looks at whether the nodes have ended


def camera() -> int:
    """`foretouch_camera`."""
    return run("camera")


def segmentation() -> int:
    """`foretouch_segmentation`."""
    return run("segmentation")


def grasp() -> int:
    """`foretouch_grasp`."""
    return run("grasp")


def touch_predictor() -> int:
    """`foretouch_touch_predictor`."""
    return run("touch_predictor")


def replay() -> int:
    """`foretouch_replay`; ends when there is nothing more to play."""
    return run("replay")


def hand() -> int:
    """`foretouch_hand`."""
    return run("hand")


def recorder() -> int:
    """`foretouch_recorder`."""
    return run("recorder")


def perception() -> int:
    """`foretouch_perception`."""
    return run(*PERCEPTION)


def run(*names: str, args: Sequence[str] | None = None) -> int:
    """Start nodes in this process and serve until Ctrl-C or shutdown.

    Args:
        names: Of nodes.
        args: Command line with ROS arguments; `sys.argv` if None.

    Returns:
        Exit status: 0, or 1 after a known error, which is told in one line on stderr.
    """
    prepare_environment()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(args=list(sys.argv if args is None else args), signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        spin(make_nodes(*names))
    except ForetouchError as err:
        sys.stderr.write(f"foretouch: {err}\n")
        return 1
    except KeyboardInterrupt:  # while the nodes were being made
        return 0
    finally:
        rclpy.try_shutdown()
    return 0


def make_nodes(*names: str, **options: Any) -> list[ForetouchNode[Any]]:
    """Nodes by name, not yet configured; `rclpy.init` has been called.

    Args:
        names: Of nodes.
        options: For rclpy's `Node`, such as `parameter_overrides`.

    Raises:
        ConfigError: If a parameter given at the start breaks a rule.
    """
    nodes: list[ForetouchNode[Any]] = []
    try:
        for name in names:
            module, class_name = _CLASSES[name]
            make: Callable[..., ForetouchNode[Any]] = getattr(import_module(module), class_name)
            nodes.append(make(**options))
    except ForetouchError:
        for node in nodes:
            node.destroy_node()
        raise
    _warn_of_unknown_parameters(nodes)
    return nodes


def spin(nodes: Sequence[ForetouchNode[Any]]) -> None:
    """Start nodes, serve them until Ctrl-C or shutdown, or until each has ended by itself, and destroy them."""
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    try:
        for node in nodes:
            executor.add_node(node)
            node.autostart()
        while not all(node.has_ended() for node in nodes):
            executor.spin_once(timeout_sec=_POLL_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        for node in nodes:
            node.stop()
        executor.shutdown(timeout_sec=1.0)
        for node in nodes:
            node.destroy_node()


def _interrupt(number: int, _: FrameType | None) -> None:
    """Both signals end the process in order; rclpy's own handler pulls the graph away from under the threads."""
    signal.signal(number, signal.SIG_DFL)  # a second one is not to be argued with
    raise KeyboardInterrupt(signal.Signals(number).name)


def _warn_of_unknown_parameters(nodes: Sequence[ForetouchNode[Any]]) -> None:
    """A parameter that reaches all nodes of a process needs to be known to one of them only."""
    for node in nodes:
        for name in sorted(node.unknown_parameters()):
            if not any(other.has_parameter(name) for other in nodes):
                node.get_logger().warning(f"parameter {name}: unknown to {node.get_name()}; it has no effect")
