# SPDX-License-Identifier: Apache-2.0
"""Real nodes over real DDS. The tests of a worker share one participant; each destroys the nodes that it made."""

import contextlib
import gc
import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakSet

import numpy as np
import pytest
from process_domain import take_domain

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install foretouch[ros]")
pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built: pip install ./foretouch_msgs")

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
from foretouch.ros.runtime.environment import prepare_environment

prepare_environment()

import rclpy  # noqa: E402
from action_msgs.msg import GoalStatus  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.exceptions import InvalidHandle  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rclpy.logging import LoggingSeverity  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402

from foretouch.ros.nodes import NODES  # noqa: E402
from foretouch.ros.runtime.internal_errors import InternalErrors, spin_on  # noqa: E402

_domains = itertools.count()
_destroyed: WeakSet[Any] = WeakSet()
"""Nodes of earlier tests. rclpy lists them, as a second graph, until they are collected; fixtures and ending threads hold them."""


def open_domain(*, new: bool) -> int:
    """The domain of the context that all tests of a worker share, or a new one, 1 to 75, that no other program of tests is in."""
    if new or not rclpy.ok():
        rclpy.try_shutdown()
        worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
        rclpy.init(
            domain_id=take_domain(25 * (worker % 3) + (os.getpid() + next(_domains)) % 25 + 1 for _ in range(25))
        )
    return rclpy.get_default_context().get_domain_id()


@dataclass(frozen=True)
class Report:
    """One report of a node in /diagnostics."""

    level: int
    message: str
    values: dict[str, str]


class Graph:
    """Nodes of foretouch, and a plain rclpy node that talks to them, served by one executor thread.

    With `alone`, the domain is a new one and is left at the end: for tests that start processes.
    """

    def __init__(self, *, alone: bool = False) -> None:
        self._alone = alone
        for _ in range(100):
            if not _destroyed:
                break
            gc.collect()
            time.sleep(0.05)
        self.domain = open_domain(new=alone or bool(_destroyed))  # a new one does not list those that are still held
        _destroyed.clear()
        self.probe = Node("probe", namespace="/foretouch")
        self.probe.get_logger().set_level(LoggingSeverity.FATAL)
        self.nodes: list[Any] = []
        self._processes: list[subprocess.Popen[str]] = []
        self._errors = InternalErrors(print)
        self._executor = SingleThreadedExecutor()
        self._closing = threading.Event()
        self._executor.add_node(self.probe)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            spin_on(self._executor, self._errors, self._closing.is_set, 1.0)  # as executables do

    def add(self, *names: str, **parameters: Any) -> list[Any]:
        """Make and start nodes; parameter names may hold dots written as two underscores."""
        made = []
        for name in names:
            looks = {"input": "points"} if name in {"perception", "segmentation"} else {}  # most tests send clouds
            made.append(NODES.load(name)(parameter_overrides=_parameters(looks | parameters)))
        for node in made:
            self.serve(node)
            node.autostart()
        return made

    @staticmethod
    def parameters(**values: Any) -> list[Parameter]:
        """Parameters by name, in which dots are written as two underscores."""
        return _parameters(values)

    def serve(self, *nodes: Any) -> None:
        """Serve nodes that the test has made, and destroy them at the end."""
        for node in nodes:
            self._executor.add_node(node)
            self.nodes.append(node)

    def remove(self, *nodes: Any) -> None:
        """Destroy nodes now."""
        for node in nodes:
            self._executor.remove_node(node)
            node.destroy_node()
            self.nodes.remove(node)
            del node
        gc.collect()  # or rclpy would list them still

    @staticmethod
    def set(node: Any, **values: Any) -> None:
        """Change parameters of a running node, all or none."""
        assert node.set_parameters_atomically(_parameters(values)).successful

    def start(self, code: str, *ros_arguments: str) -> subprocess.Popen[str]:
        """Start a process in the domain: an executable of the package, or a program."""
        if code.isidentifier():
            code = f"import sys; from foretouch.ros.executables import {code}; sys.exit({code}())"
        command = [sys.executable, "-c", code, *(["--ros-args", *ros_arguments] if ros_arguments else [])]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self._processes.append(subprocess.Popen(command, env=self.environment(), **pipes))
        return self._processes[-1]

    def environment(self) -> dict[str, str]:
        """For a process in the domain."""
        return {**os.environ, "ROS_DOMAIN_ID": str(self.domain)}

    def listen(self, message: type, topic: str, *, reliable: bool = True) -> list[Any]:
        """A list that fills with what a topic sends."""
        heard: list[Any] = []
        self.probe.create_subscription(message, topic, heard.append, _profile(reliable=reliable))
        return heard

    def reports(self, name: str) -> list[Report]:
        """A list that fills with what a node reports in /diagnostics."""
        found: list[Report] = []

        def hear(message: DiagnosticArray) -> None:
            for one in message.status:
                if one.name == f"/foretouch/{name}":
                    values = {pair.key: pair.value for pair in one.values}
                    found.append(Report(one.level, one.message, values))

        self.probe.create_subscription(DiagnosticArray, "/diagnostics", hear, 100)
        return found

    def talk(self, message: type, topic: str, *, reliable: bool = True) -> Any:
        """A publisher; wait with `matched` before using it."""
        return self.probe.create_publisher(message, topic, _profile(reliable=reliable))

    def talk_matched(self, message: type, topic: str, *, reliable: bool = True) -> Any:
        """A publisher that can be used at once."""
        publisher = self.talk(message, topic, reliable=reliable)
        self.matched(topic)
        return publisher

    def matched(self, *topics: str, publishers: int = 1, subscribers: int = 1) -> None:
        """Wait until all ends of topics know each other; so many of them at least, nodes of other processes included."""
        for name in map(self.probe.resolve_topic_name, topics):
            self.until(lambda name=name: self.probe.count_publishers(name) >= publishers)
            self.until(lambda name=name: self.probe.count_subscribers(name) >= subscribers)
            local = [self.probe, *self.nodes]

            def ends(name: str = name, local: list[Any] = local) -> tuple[list[Any], list[Any]]:
                """Those of this process now: a subscription may be replaced, to follow its publishers."""
                kinds = ([*node.publishers] for node in local), ([*node.subscriptions] for node in local)
                sending, hearing = (
                    [one for found in kind for one in found if one.topic_name == name] for kind in kinds
                )
                return sending, hearing

            def know_each_other(ends: Callable[[], tuple[list[Any], list[Any]]] = ends) -> bool:
                with contextlib.suppress(InvalidHandle):
                    sending, hearing = ends()
                    heard, sent = max(subscribers, len(hearing)), max(publishers, len(sending))
                    return all(one.get_subscription_count() >= heard for one in sending) and all(
                        one.get_publisher_count() >= sent for one in hearing
                    )
                return False

            self.until(know_each_other)
            sending, hearing = ends()
            if len(sending) < publishers or len(hearing) < subscribers:
                time.sleep(0.5)  # the ends in other processes cannot be asked

    def call(self, service: type, name: str, request: Any = None) -> Any:
        """The answer of a service, by default to an empty request."""
        client = self.probe.create_client(service, name)
        assert client.wait_for_service(10.0), f"{name} is not offered"
        future = client.call_async(service.Request() if request is None else request)
        self.until(future.done)
        self.probe.destroy_client(client)
        return future.result()

    def change(self, name: str, *transitions: str) -> bool:
        """Ask a node for transitions such as `deactivate`; whether all have succeeded."""
        requests = [ChangeState.Request(transition=Transition(label=transition)) for transition in transitions]
        return all(self.call(ChangeState, f"{name}/change_state", request).success for request in requests)

    def goal(self, kind: Any, name: str, goal: Any) -> tuple[int, Any, list[Any]]:
        """The status and the result of a goal, and its feedback."""
        feedback: list[Any] = []
        sent = self.action_client(kind, name).send_goal_async(goal, lambda message: feedback.append(message.feedback))
        self.until(sent.done)
        future = sent.result().get_result_async()
        self.until(future.done)
        status, result = future.result().status, future.result().result
        self.until(lambda: feedback or status != GoalStatus.STATUS_SUCCEEDED)
        return status, result, feedback

    def action_client(self, kind: type, name: str, **options: Any) -> Any:
        """A client, on a node that is served once the client is complete: its constructor makes it known too early."""
        node = Node("planner", namespace="/foretouch")
        client = ActionClient(node, kind, name, **options)
        self.serve(node)
        assert client.wait_for_server(10.0), f"{name} is not offered"
        return client

    def until(self, condition: Callable[[], Any], timeout_s: float = 45.0) -> None:
        """Wait for something to become true."""
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, "nothing happened in time"
            time.sleep(0.005)

    def close(self) -> None:
        """Kill the processes that still run and destroy all nodes."""
        for process in self._processes:
            process.kill()
            process.communicate(timeout=10.0)
        self._closing.set()
        self._executor.shutdown(timeout_sec=2.0)
        self._thread.join(5.0)
        for node in (*self.nodes, self.probe):
            node.destroy_node()
            _destroyed.add(node)
            del node
        if self._alone:
            rclpy.try_shutdown()
        self.nodes.clear()
        gc.collect()


def _parameters(values: dict[str, Any]) -> list[Parameter]:
    return [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]


def _profile(*, reliable: bool) -> QoSProfile:
    return QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture(scope="module", autouse=True)
def _frozen() -> None:
    """Let the collections after tests look at what the tests of the module made alone, not at all that is loaded."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def graph() -> Iterator[Graph]:
    """In the context of the worker."""
    one = Graph()
    yield one
    one.close()


@pytest.fixture
def lone_graph() -> Iterator[Graph]:
    """In a domain of its own, for tests that start processes."""
    one = Graph(alone=True)
    yield one
    one.close()


@pytest.fixture(scope="module")
def module_graph() -> Iterator[Graph]:
    """One for all tests of a module."""
    one = Graph()
    yield one
    one.close()


@pytest.fixture(scope="session")
def model_card(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small network with random weights: what it predicts is wrong, how it travels is the same."""
    from calibrated_models import save_small_network

    return save_small_network(tmp_path_factory.mktemp("model"), "small", np.linspace(1700.0, 3300.0, 50))


@pytest.fixture
def predictor(graph: Graph) -> Callable[..., tuple[Any, Callable[[int], None], list[Any]]]:
    """Starts a touch predictor; gives it, a function that sends it a cloud with a grasp by stamp, and its answers."""
    from contact_model_builders import can_with_grasps
    from sensor_msgs.msg import PointCloud2

    from foretouch.ros.messages.clouds import objects_to_msg
    from foretouch.ros.messages.conversions import grasp_to_msg
    from foretouch.types import ASSUMED_TABLE
    from foretouch.types.scene import Object
    from foretouch_msgs.msg import GraspArray, TouchPredictionArray

    cloud, planned = can_with_grasps(1)

    def start(**parameters: Any) -> tuple[Any, Callable[[int], None], list[Any]]:
        (node,) = graph.add("touch_predictor", **parameters)
        heard = graph.listen(TouchPredictionArray, "touch")
        clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
        graph.matched("object_cloud", "grasps", "touch")

        def send(stamp: int) -> None:
            message = objects_to_msg([Object.of("1", cloud, ASSUMED_TABLE)], "cam", stamp)
            clouds.publish(message)
            grasps.publish(GraspArray(header=message.header, grasps=[grasp_to_msg(one) for one in planned]))

        return node, send, heard

    return start


@pytest.fixture(scope="session")
def scene_cloud() -> Callable[..., Any]:
    """Builds the cloud of a small scene with one object or more, by seed and stamp."""
    from benchmarks.random_scenes import random_scene

    def build(seed: int = 0, stamp_ns: int = 1_700_000_000_123_456_789, n_objects: int = 2, width: int = 424) -> Any:
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, width=width, height=round(width * 30 / 53), n_objects=n_objects)
        return scene.render().cloud(frame_id="camera_depth_optical_frame", stamp_ns=stamp_ns)

    return build
