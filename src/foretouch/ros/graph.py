# SPDX-License-Identifier: Apache-2.0
"""Several nodes in one process, of an executable or of the commands `run`, `replay` and `record`.

Threads: the executor spins in the background, so that the caller's thread is free to draw and to handle Ctrl-C.
"""

import re
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self, cast

from foretouch.base.interrupts import uninterrupted
from foretouch.errors import ConfigError, ForetouchError
from foretouch.ros.nodes import NODES, node_class
from foretouch.ros.runtime.environment import prepare_environment, stale_bytes, start_rclpy
from foretouch.ros.runtime.parameter_files import check_parameters
from foretouch.topics import NAMESPACE

if TYPE_CHECKING:
    from foretouch.ros.nodes.monitor import MonitorNode
    from foretouch.ros.nodes.replay import ReplayNode
    from foretouch.ros.runtime.lifecycle_node import ForetouchNode


_INPUTS = {
    "sensor_msgs/msg/Image": "depth",
    "sensor_msgs/msg/CompressedImage": "depth",
    "sensor_msgs/msg/PointCloud2": "points",
}  # of perception, by type of message

_SOURCES = ("replay", "camera")


class Graph:
    """Nodes, and a monitor, that run while the context is open; on entering, a `ConfigError` if a parameter breaks a rule.

    Args:
        nodes: Parameters of each node by its name (see `NODES`).
        namespace: Of all nodes.
        params_file: Parameters of nodes in a file.
        monitor: Options of `MonitorNode`; None for no monitor.
        arguments: A command line with ROS arguments.
    """

    def __init__(
        self,
        nodes: Mapping[str, Mapping[str, Any]],
        *,
        namespace: str | None = None,
        params_file: str | Path | None = None,
        monitor: Mapping[str, Any] | None = MappingProxyType({}),
        arguments: Sequence[str] = (),
    ) -> None:
        self._parameters = nodes
        self._namespace: dict[str, Any] = {} if namespace is None else {"namespace": _checked(namespace)}
        given = [] if params_file is None else ["--ros-args", "--params-file", str(params_file)]
        self._arguments = [*arguments, *given]
        self._monitor_options = monitor
        self._closing, self._closed = threading.Event(), ExitStack()
        self._thread: threading.Thread | None = None
        self._last_played = 0  # of a topic of others, when it was left
        self.nodes: dict[str, ForetouchNode[Any]] = {}
        self.monitor: MonitorNode

    def __enter__(self) -> Self:
        prepare_environment()
        import rclpy  # noqa: F401  (where ROS is absent, the command says so, and not its first node)

        stale_bytes(free=True)
        for name in self._parameters:
            node_class(name)
        check_parameters(self._arguments, NODES, self._parameters, **self._namespace)
        start_rclpy(self._arguments)
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop and destroy all nodes, the last one started first."""
        with uninterrupted():
            for node in reversed(self.nodes.values()):
                node.stop()
            time.sleep(0.1)  # for messages in flight: rclpy's shutdown breaks running callbacks
            self._closing.set()
            self._closed.close()

    def _start(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        from foretouch.ros.nodes.monitor import MonitorNode
        from foretouch.ros.runtime.internal_errors import spin_on

        self._closed.callback(rclpy.try_shutdown)
        served: list[MonitorNode | ForetouchNode[Any]] = []
        with uninterrupted():
            if self._monitor_options is not None:
                self.monitor = MonitorNode(**self._namespace, **self._monitor_options)
                self._closed.callback(self.monitor.destroy_node)
                served.append(self.monitor)
        for name, parameters in self._parameters.items():
            with uninterrupted():
                node = node_class(name)(parameter_overrides=_parameters(parameters), **self._namespace)
                self._closed.callback(node.destroy_node)
                self.nodes[name] = node
                served.append(node)
        with uninterrupted():
            executor = SingleThreadedExecutor()
            self._closed.callback(executor.shutdown, timeout_sec=1.0)
            for each in served:
                executor.add_node(each)
        for node in self.nodes.values():
            with uninterrupted():
                node.autostart()

        def serve() -> None:
            with suppress(rclpy.executors.ExternalShutdownException):
                spin_on(executor, served[0].internal_errors, self._closing.is_set, 0.2)

        self._thread = threading.Thread(target=serve, name="executor", daemon=True)
        self._thread.start()
        self._closed.callback(self._thread.join, timeout=2.0)

    def require_active(self) -> None:
        """Raise a `ForetouchError` that gives the cause, if a node with `autostart` is not active."""
        causes = [
            f"{name}: {node.failure or node.state_name}"
            for name, node in self.nodes.items()
            if node.state_name != "active" and node.config.autostart
        ]
        if causes:
            raise ForetouchError(f"a node did not start: {'; '.join(causes)}")

    def wait_until_ended(self) -> None:
        """Wait until each node has ended by itself, or the context of rclpy is shut down."""
        while self._thread is not None and self._thread.is_alive():
            if all(node.has_ended() for node in self.nodes.values()):
                return
            time.sleep(0.2)

    @property
    def replay(self) -> "ReplayNode | None":
        """The replay, if it is one of the nodes."""
        return cast("ReplayNode | None", self.nodes.get("replay"))

    def conflicts(self) -> list[str]:
        """List the signs of a second graph in the namespace, a line each, now or before."""
        for node in self.nodes.values():
            node.look_for_second_graph()
        return list(dict.fromkeys(text for node in self.nodes.values() for text in node.past_conflicts))

    def played(self) -> int:
        """Return clouds published by the replay or the camera; received from a topic of others."""
        counts = [self.nodes[name].statistics.summary().used for name in _SOURCES if name in self.nodes]
        if counts:
            return sum(counts)
        return self._last_played or self.nodes["perception"].statistics.summary().received

    def stop_source(self) -> None:
        """Publish no more clouds; of a topic of others, count no more clouds and answers."""
        own = [self.nodes[name] for name in _SOURCES if name in self.nodes]
        if not own:
            self.monitor.close_view()
        self._last_played = self.played()
        for node in own:
            node.stop()

    def wait_for_hand(self, timeout_s: float) -> bool:
        """Let the simulated hand finish its grasp and start no other; False if it takes longer than a time [s]."""
        hand, end = cast("Any", self.nodes.get("hand")), time.monotonic() + timeout_s
        if hand is not None:
            hand.set_parameters(list(_parameters({"automatic": False})))
        while hand is not None and hand.busy:
            if time.monotonic() > end:
                return False
            time.sleep(0.05)
        return True

    def answered(self) -> int:
        """Arrays of predictions received by the monitor."""
        return sum(self.monitor.view().answers.values())

    def wait_for_answers(self, count: int) -> bool:
        """Wait until the monitor has received `count` answers; False once none has come for five seconds."""
        answered, last = 0, time.monotonic()
        while (now := self.answered()) < count:
            if now > answered:
                answered, last = now, time.monotonic()
            if time.monotonic() - last > 5.0:
                return False
            time.sleep(0.02)
        return True


def input_of(topic: str, wait_s: float) -> str:
    """Find out what a topic of a camera is for `perception`: `depth` or `points`.

    Args:
        topic: Full name.
        wait_s: Longest wait until a node publishes it [s].

    Raises:
        ConfigError: If no node publishes it, or it is neither images nor clouds.
    """
    start_rclpy([])
    import rclpy

    node = rclpy.create_node("foretouch_look")
    end = time.monotonic() + wait_s
    kinds = dict[str, list[str]]()
    try:
        while topic not in kinds and time.monotonic() < end:
            time.sleep(0.1)
            kinds = {name: types for name, types in node.get_topic_names_and_types() if node.count_publishers(name)}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    for kind in kinds.get(topic, ()):
        if kind in _INPUTS:
            return _INPUTS[kind]
    usable = sorted(name for name, types in kinds.items() if any(kind in _INPUTS for kind in types))
    fault = f"is a {' and a '.join(kinds[topic])}" if topic in kinds else f"no node published it within {wait_s:g} s"
    cure = "no images or clouds are published here: start the driver of the camera, with the same ROS_DOMAIN_ID"
    if usable:
        cure = f"images and clouds are published on {', '.join(usable)}"
    raise ConfigError(f"{topic}: {fault}; {cure}")


def call_trigger(service: str, namespace: str | None, wait_s: float) -> tuple[bool, str]:
    """Call a service without arguments of a graph that runs elsewhere.

    Args:
        service: Name in the namespace.
        namespace: Of the graph; None for `/foretouch`.
        wait_s: Longest wait for the service, and then for its answer [s].

    Returns:
        Whether it succeeded, and its message.

    Raises:
        ForetouchError: If there is no such service, or no answer within the time.
    """
    namespace = _checked(namespace or NAMESPACE)
    start_rclpy([])
    import rclpy
    from std_srvs.srv import Trigger

    try:
        answer = call_service(Trigger, f"{namespace.rstrip('/')}/{service}", Trigger.Request(), wait_s)
        return answer.success, answer.message
    finally:
        rclpy.try_shutdown()


def call_service(kind: Any, name: str, request: Any, wait_s: float) -> Any:
    """Call a service, and return its answer; rclpy must have been started.

    Args:
        kind: Type of the service.
        name: Full name of the service.
        request: Of this type.
        wait_s: Longest wait for the service, and then for its answer [s].

    Raises:
        ForetouchError: If there is no such service, or no answer within the time.
    """
    import rclpy

    node = rclpy.create_node("caller", namespace=name.rpartition("/")[0])
    try:
        client = node.create_client(kind, name)
        if not client.wait_for_service(timeout_sec=wait_s):
            raise ForetouchError(f"{name}: no such service within {wait_s:g} s: is the graph running?")
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=wait_s)
        if future.result() is None:
            raise ForetouchError(f"{name}: no answer within {wait_s:g} s")
        return future.result()
    finally:
        node.destroy_node()


def _checked(namespace: str) -> str:
    """Check a namespace; a `ConfigError` if ROS does not accept it."""
    if not re.fullmatch(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", namespace, re.ASCII):
        raise ConfigError(f"namespace: {namespace!r} is not words of letters, digits and _ with / between them")
    return namespace


def _parameters(values: Mapping[str, Any]) -> Sequence[Any]:
    from rclpy.parameter import Parameter

    return [Parameter(name, value=value) for name, value in values.items()]
