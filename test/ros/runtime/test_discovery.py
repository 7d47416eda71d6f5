# SPDX-License-Identifier: Apache-2.0
"""What late subscribers get, what a source waits for, and two graphs in one namespace, over real DDS."""

import json
import signal
import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from foretouch.dataset.bag_writer import write_bag
from foretouch.errors import ConfigError
from foretouch.ros.executables import PERCEPTION
from foretouch.ros.runtime.discovery import UPTIME, Matching
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import GraspArray, Status, TouchPredictionArray

pytestmark = pytest.mark.ros

TOPICS = {"grasps": GraspArray, "touch": TouchPredictionArray}
LATE = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOUCH, PREDICTOR = "/foretouch/touch", "/foretouch/touch_predictor"


def answer(node, *stamps):
    """Publish empty answers."""
    for stamp in stamps:
        header = Header(frame_id="lens")
        header.stamp.nanosec = stamp
        node._refuse(header, Status.NO_GRASP, "none")


def listen_late(graph, topic):
    heard = []
    graph.probe.create_subscription(TOPICS[topic], topic, heard.append, LATE)
    return heard


def stamps(messages):
    return [stamp_ns(message.header.stamp) for message in messages]


def test_late_subscribers_that_ask_for_them_get_the_last_ten_answers_until_the_node_is_cleaned_up(graph, model_card):
    """Of the grasps too, which the nodes of one process hand over as objects."""
    nodes = dict(
        zip(TOPICS, graph.add("grasp", "touch_predictor", model=model_card, partner_timeout_s=3600.0), strict=True)
    )
    for node in nodes.values():
        answer(node, *range(1, 13))
    assert graph.change("grasp", "deactivate")  # they are kept
    late = {topic: listen_late(graph, topic) for topic in TOPICS}
    for topic in TOPICS:
        graph.until(lambda topic=topic: len(late[topic]) == 10)
    assert graph.change("grasp", "cleanup", "configure", "activate")
    volatile = {topic: graph.listen(kind, topic) for topic, kind in TOPICS.items()}
    second = listen_late(graph, "grasps")
    graph.matched("grasps", subscribers=3)
    graph.matched("touch", subscribers=2)
    for topic in TOPICS:
        answer(nodes[topic], 13)
        graph.until(lambda topic=topic: volatile[topic] and len(late[topic]) == 11)
        assert stamps(late[topic]) == [*range(3, 14)]
        assert stamps(volatile[topic]) == [13]
    graph.until(lambda: second)
    assert stamps(second) == [13]


def test_a_node_reports_its_matches_at_once(graph):
    reports, key = graph.reports("grasp"), "matched_subscribers./foretouch/grasps"
    graph.add("grasp", diagnostics_period_s=60.0)
    graph.until(lambda: reports and reports[-1].values.get(key) == "0")
    assert float(reports[-1].values[UPTIME]) < 60.0
    graph.listen(GraspArray, "grasps")
    graph.until(lambda: reports[-1].values[key] == "1")
    (node,) = graph.add("grasp", **{"qos_overrides./foretouch/grasps.publisher.durability": "volatile"})
    assert not node._grasps.keeps


def reported(uptime_s, state="active", **ends):
    """As a predictor reports."""
    values = {"state": state, UPTIME: str(uptime_s), **{f"{kind}.{TOUCH}": str(count) for kind, count in ends.items()}}
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticArray(status=[DiagnosticStatus(name=PREDICTOR, values=pairs)])


@pytest.fixture
def predictor(graph):
    """A node that stands for the predictor of another process, with a volatile publisher."""
    node = Node("touch_predictor", namespace="/foretouch")
    node.get_logger().set_level(LoggingSeverity.FATAL)  # it would warn of incompatible QoS
    node.create_publisher(TouchPredictionArray, "touch", 10)
    graph.serve(node)
    return node


def test_a_subscriber_that_is_seen_must_be_matched(graph, predictor):
    matching = Matching(graph.probe, 0.0, ())
    graph.listen(TouchPredictionArray, "touch")
    listen_late(graph, "touch")  # the publisher is volatile: these never match
    graph.until(lambda: graph.probe.count_subscribers(TOUCH) == 2)
    graph.until(lambda: graph.probe.get_publishers_info_by_topic(TOUCH))
    assert matching.missing() == []
    matching.receive(reported(1.0, matched_subscribers=0))
    assert matching.missing() == [f"{TOUCH}: 1 of 1 subscribers of {PREDICTOR}"]
    matching.receive(reported(1.0, matched_subscribers=1))
    assert matching.missing() == []


def test_a_node_that_reports_must_have_reported_and_run_long_enough_to_be_discovered(graph, predictor):
    matching = Matching(graph.probe, 3.0, ())
    predictor.create_publisher(DiagnosticArray, "/diagnostics", 10)
    graph.until(lambda: matching.missing() == [f"{PREDICTOR}: no report in /diagnostics"])
    matching.receive(reported(1.0, "unconfigured"))  # it has made no publisher yet
    assert matching.missing() == [f"{PREDICTOR}: no report in /diagnostics"]
    matching.receive(reported(2.0))
    assert (matching.missing(), matching.is_discovered()) == ([], False)
    matching.receive(reported(3.0))
    assert matching.is_discovered()


def test_a_topic_to_wait_for_needs_a_name_and_a_subscriber_of_another_program(graph):
    with pytest.raises(ConfigError, match="wait_for: 'a b' is not a valid topic name"):
        Matching(graph.probe, 0.0, ["a b"])
    matching = Matching(graph.probe, 0.0, ["touch"])
    own, other = Node("monitor", namespace="/foretouch"), Node("planner")
    graph.serve(own, other)
    own.create_subscription(TouchPredictionArray, "touch", print, 10)
    graph.until(lambda: graph.probe.count_subscribers(TOUCH) == 1)
    assert matching.missing() == [f"{TOUCH}: no subscriber"]
    other.create_subscription(TouchPredictionArray, TOUCH, print, 10)
    graph.until(lambda: matching.missing() == [])


SEGMENTATION = "2 nodes are named /foretouch/segmentation"


def foretouch(graph, *words):
    """The last line of a command's JSON, and what it wrote to stderr."""
    command = [sys.executable, "-m", "foretouch.cli.main", *map(str, words), "--json"]
    done = subprocess.run(command, env=graph.environment(), capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


@pytest.fixture
def recording(tmp_path, scene_cloud):
    write_bag(tmp_path / "recording", [scene_cloud(stamp_ns=stamp, width=212) for stamp in (1, 2)])
    return tmp_path / "recording"


def test_answers_of_a_node_of_another_name_are_reported(graph):
    node, touch = graph.add("segmentation", "touch_predictor", model="none")
    publisher = graph.talk(TouchPredictionArray, "touch")
    text = "/foretouch/touch has 2 publishers: /foretouch/probe, /foretouch/touch_predictor"
    graph.until(lambda: touch.conflicts == (text,))
    assert node.conflicts == ()
    graph.probe.destroy_publisher(publisher)
    graph.until(lambda: touch.conflicts == ())


@pytest.mark.slow
def test_nodes_of_the_same_name_are_reported_by_both_and_forgotten_when_one_ends(lone_graph):
    graph = lone_graph
    (node,) = graph.add("segmentation", diagnostics_period_s=0.1)
    reports = graph.reports("segmentation")
    graph.until(lambda: reports)
    assert (node.conflicts, reports[-1].level) == ((), DiagnosticStatus.WARN)  # no input yet
    other = graph.start("segmentation", "-p", "diagnostics_period_s:=0.1")
    graph.until(lambda: node.conflicts == (SEGMENTATION,))
    graph.until(lambda: SEGMENTATION in reports[-1].message)
    assert reports[-1].level == DiagnosticStatus.WARN
    # Fast DDS may write lines of its own before, such as of a port that a program of another domain has taken.
    line = next(line for line in other.stderr if "a second graph" in line)
    assert f"a second graph or source runs in /foretouch: {SEGMENTATION}" in line
    other.send_signal(signal.SIGINT)
    _, logged = other.communicate(timeout=20)
    assert (other.returncode, logged.count("a second graph")) == (0, 0)  # once was enough
    graph.until(lambda: node.conflicts == ())
    since = node.uptime_s() + 0.05  # reports that were made before may be on their way
    graph.until(lambda: float(reports[-1].values[UPTIME]) > since)
    assert SEGMENTATION not in reports[-1].message


@pytest.mark.slow
def test_replay_and_run_print_that_another_graph_answers_too(lone_graph, recording, model_card):
    graph = lone_graph
    graph.add(*PERCEPTION, model=model_card)
    counts, printed = foretouch(graph, "run", "--source", recording, "--model", model_card)
    assert counts["answered"] > counts["played"] == 2
    line = next(line for line in printed.splitlines() if line.startswith("foretouch: a second graph"))
    for name in PERCEPTION:
        assert f"2 nodes are named /foretouch/{name}" in line
        assert f"2 nodes are named /foretouch/{name}" in counts["conflicts"]
    graph.start("segmentation", "-p", "diagnostics_period_s:=1.0")
    graph.until(lambda: graph.probe.count_publishers("/foretouch/objects") == 2)
    counts, printed = foretouch(graph, "replay", recording, "--restamp")
    text = "/foretouch/objects has 2 publishers: /foretouch/segmentation, /foretouch/segmentation"
    assert (counts["clouds"], counts["conflicts"]) == (2, [text])
    assert f"foretouch: a second graph or source runs in the namespace: {text}" in printed.splitlines()
