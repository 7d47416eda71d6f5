# SPDX-License-Identifier: Apache-2.0
"""Real nodes over real DDS, each test in a domain of its own."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install foretouch[ros]")
pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built: pip install ./foretouch_msgs")

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
from foretouch.ros.runtime.environment import prepare_environment

prepare_environment()

import rclpy  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.executors import ExternalShutdownException  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402

from foretouch.ros.executables import make_nodes  # noqa: E402
from foretouch.ros.runtime.executor import GraphExecutor  # noqa: E402
from foretouch.ros.runtime.internal_errors import InternalErrors, spin_on  # noqa: E402

_counter = itertools.count()
_COLLECTED = 5  # domains between two collections, which take a quarter of a second


def next_domain() -> int:
    """1 to 75, 25 for each of three workers; the same one comes again only after 24 other tests."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return 25 * (worker % 3) + (os.getpid() + next(_counter)) % 25 + 1


class Graph:
    """Nodes of foretouch, and a plain rclpy node that talks to them, served by one executor thread."""

    def __init__(self) -> None:
        self.domain = next_domain()
        rclpy.init(domain_id=self.domain)
        self.probe = Node("probe", namespace="/foretouch")
        self.nodes: list[Any] = []
        self._errors = InternalErrors(print)
        self._executor = GraphExecutor(self._errors)
        self._closing = threading.Event()
        self._executor.add_node(self.probe)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            spin_on(self._executor, self._errors, self._closing.is_set, 1.0)  # as executables do

    def add(self, *names: str, **parameters: Any) -> list[Any]:
        """Make and start nodes; parameter names may hold dots written as two underscores."""
        overrides = [Parameter(name.replace("__", "."), value=value) for name, value in parameters.items()]
        made = make_nodes(*names, parameter_overrides=overrides)
        for node in made:
            self._executor.add_node(node)
            node.autostart()
        self.nodes += made
        return made

    def listen(self, message: type, topic: str, *, reliable: bool = True) -> list[Any]:
        """A list that fills with what a topic sends."""
        heard: list[Any] = []
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self.probe.create_subscription(message, topic, heard.append, QoSProfile(depth=100, reliability=reliability))
        return heard

    def talk(self, message: type, topic: str, *, reliable: bool = True) -> Any:
        """A publisher; wait with `matched` before using it."""
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        return self.probe.create_publisher(message, topic, QoSProfile(depth=100, reliability=reliability))

    def matched(self, topic: str, publishers: int = 1, subscribers: int = 1) -> None:
        """Wait until all ends of a topic know each other; so many of them at least, nodes of other processes included."""
        name = self.probe.resolve_topic_name(topic)
        self.until(lambda: self.probe.count_publishers(name) >= publishers)
        self.until(lambda: self.probe.count_subscribers(name) >= subscribers)
        local = [self.probe, *self.nodes]
        sending = [end for node in local for end in node.publishers if end.topic_name == name]
        hearing = [end for node in local for end in node.subscriptions if end.topic_name == name]
        self.until(lambda: all(end.get_subscription_count() >= max(subscribers, len(hearing)) for end in sending))
        self.until(lambda: all(end.get_publisher_count() >= max(publishers, len(sending)) for end in hearing))
        if len(sending) < publishers or len(hearing) < subscribers:
            time.sleep(0.5)  # the ends in other processes cannot be asked

    def call(self, service: type, name: str, request: Any) -> Any:
        """The answer of a service."""
        client = self.probe.create_client(service, name)
        assert client.wait_for_service(10.0), f"{name} is not offered"
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def action_client(self, kind: type, name: str) -> Any:
        """A client, on a node that is served once the client is complete: its constructor makes it known too early."""
        node = Node("planner", namespace="/foretouch")
        client = ActionClient(node, kind, name)
        self.nodes.append(node)
        self._executor.add_node(node)
        assert client.wait_for_server(10.0), f"{name} is not offered"
        return client

    def until(self, condition: Callable[[], Any], timeout_s: float = 45.0) -> None:
        """Wait for something to become true."""
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, "nothing happened in time"
            time.sleep(0.01)

    def close(self) -> None:
        """Destroy all and leave the domain."""
        self._closing.set()
        self._executor.shutdown(timeout_sec=2.0)
        self._thread.join(5.0)
        for node in (*self.nodes, self.probe):
            node.destroy_node()
        rclpy.try_shutdown()
        if self.domain % _COLLECTED == 0:
            gc.collect()  # participants of contexts that refer to themselves would stay in domains that come again


@pytest.fixture
def graph() -> Iterator[Graph]:
    one = Graph()
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
    import torch

    from foretouch.models.network.checkpoint import save_network
    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.networks import TouchNet

    torch.manual_seed(0)
    config = ModelConfig(n_points=64, trunk_widths=(8, 16, 32), tnet_widths=(8, 8, 16, 8, 8), head_widths=(16, 8))
    net = TouchNet(config)
    net.set_scaling(torch.linspace(1700, 3300, config.output_size), torch.linspace(20, 300, config.output_size))
    return str(save_network(tmp_path_factory.mktemp("model"), "small", net.eval(), {}))


@pytest.fixture(scope="session")
def scene_cloud() -> Callable[..., Any]:
    """Builds the cloud of a small scene with one object or more, by seed and stamp."""
    import numpy as np

    from foretouch.simulation.depth_scene import random_scene

    def build(seed: int = 0, stamp_ns: int = 1_700_000_000_123_456_789, n_objects: int = 2, width: int = 424) -> Any:
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, width=width, height=round(width * 30 / 53), n_objects=n_objects)
        return scene.render().cloud(frame_id="camera_depth_optical_frame", stamp_ns=stamp_ns)

    return build
