# SPDX-License-Identifier: Apache-2.0
"""A node that was killed is named in /diagnostics and in the panel; one that ends, restarts or hears nothing is not."""

import io
import signal
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.logging import LoggingSeverity
from rich.console import Console
from sim_builders import CAN, scene

from foretouch.cli.live import live_panel
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig

pytestmark = pytest.mark.ros


class Watch:
    """What a node, the only one of the test's process, and all others report of those that are gone."""

    def __init__(self, graph):
        self.graph, self.monitor, self.found = graph, MonitorNode(), []
        self.node = ForetouchNode("watch", NodeConfig)
        self.node.get_logger().set_level(LoggingSeverity.FATAL)
        graph.serve(self.node, self.monitor)
        graph.probe.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 100)

    def _hear(self, message):
        self.found += [one for one in message.status if one.message.startswith("was killed or hangs")]

    def alive(self, *names):
        """Wait until the node hears these."""
        wanted = {f"/foretouch/{name}" for name in names}
        self.graph.until(lambda: wanted <= {name for name, _ in self.node._heartbeat._heard})
        self.graph.until(lambda: not self.node._heartbeat.gone.keys() & wanted)
        self.found.append(None)
        while self.found:  # until all others hear them too
            del self.found[:]
            time.sleep(1.5)

    def panel(self):
        """The text of the panel."""
        console = Console(file=io.StringIO(), width=120)
        console.print(live_panel(self.monitor.view(), "graph"))
        return console.file.getvalue()

    def named_after(self, name):
        """Time until a report in the place of a node, and then until the panel names it [s]."""
        began = time.monotonic()
        self.graph.until(lambda: any(one.name == f"/foretouch/{name}" for one in self.found), 10.0)
        reported_s = time.monotonic() - began
        self.graph.until(lambda: f"{name}: was killed or hangs" in self.panel(), 10.0)
        shown_s = time.monotonic() - began
        self.graph.until(lambda: f"/foretouch/{name}" in self.node._heartbeat.gone)
        return reported_s, shown_s


@pytest.fixture
def starts(lone_graph, tmp_path):
    """Starts the executable of a node with what it needs."""
    path = tmp_path / "scene.yaml"
    path.write_text(str(scene(CAN, camera={"width": 96, "height": 72}).to_mapping()), encoding="utf-8")
    needed = {
        "camera": ("-p", "source:=scene", "-p", f"scene.path:={path}"),
        "touch_predictor": ("-p", "model:=touchnet-v1"),
        "replay": ("-p", "autostart:=false"),
    }
    return lambda name: lone_graph.start(name, *needed.get(name, ()))


@pytest.mark.slow
def test_each_of_six_nodes_that_is_killed_is_named_within_two_seconds_and_its_restart_is_no_second_graph(
    lone_graph, starts
):
    names = ("camera", "replay", "segmentation", "grasp", "touch_predictor", "recorder")
    graph, watch = lone_graph, Watch(lone_graph)
    processes = {name: starts(name) for name in names}
    watch.alive(*names)
    conflicts = graph.reports("replay")
    late = {}
    for name in ("grasp", *names):
        processes[name].kill()
        reported_s, shown_s = watch.named_after(name)
        if shown_s > 2.0:
            late[name] = reported_s, shown_s
        assert watch.found[0].level == DiagnosticStatus.ERROR
        if name == names[-1]:
            break
        processes[name] = starts(name)
        watch.alive(name)
    assert late == {}
    assert len(conflicts) > 10
    assert [one.message for one in conflicts if "publishers" in one.message or "nodes are named" in one.message] == []


@pytest.mark.slow
def test_a_node_that_ends_is_not_reported_and_one_that_pauses_is_until_it_goes_on(lone_graph, starts):
    watch = Watch(lone_graph)
    ending, pausing = starts("segmentation"), starts("grasp")
    watch.alive("segmentation", "grasp")
    ending.send_signal(signal.SIGINT)
    assert ending.wait(20.0) == 0
    time.sleep(2.5)
    assert watch.found == []
    pausing.send_signal(signal.SIGSTOP)
    watch.named_after("grasp")
    pausing.send_signal(signal.SIGCONT)
    lone_graph.until(lambda: not watch.node._heartbeat.gone)
    lone_graph.until(lambda: "grasp: was killed" not in watch.panel())


def test_a_node_that_hears_nothing_for_a_while_does_not_report_the_others(graph, monkeypatch):
    watch = Watch(graph)
    graph.add("grasp")
    watch.alive("grasp")
    with monkeypatch.context() as patched:  # no input is taken
        patched.setattr(watch.node.executor._inputs, "_find", lambda: time.sleep(2.0))
        time.sleep(2.0)
    time.sleep(1.0)
    assert watch.found == []
