# SPDX-License-Identifier: Apache-2.0
"""What late subscribers get, and what a source waits for, over real DDS."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from foretouch.errors import ConfigError
from foretouch.ros.runtime.matching import UPTIME, Matching
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import GraspArray, Status, TouchPredictionArray

pytestmark = pytest.mark.ros

TOPICS = {"grasps": GraspArray, "touch": TouchPredictionArray}
LATE = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOUCH, PREDICTOR = "/foretouch/touch", "/foretouch/touch_predictor"


def answer(node: Any, *stamps: int) -> None:
    """Publish empty answers."""
    for stamp in stamps:
        header = Header(frame_id="lens")
        header.stamp.nanosec = stamp
        node.refuse(header, Status.NO_GRASP, "none")


def listen_late(graph: Any, topic: str) -> list[Any]:
    heard: list[Any] = []
    graph.probe.create_subscription(TOPICS[topic], topic, heard.append, LATE)
    return heard


def stamps(messages: list[Any]) -> list[int]:
    return [stamp_ns(message.header.stamp) for message in messages]


def change(graph: Any, *transitions: int) -> None:
    for one in transitions:
        assert graph.call(ChangeState, "grasp/change_state", ChangeState.Request(transition=Transition(id=one))).success


def test_late_subscribers_that_ask_for_them_get_the_last_ten_answers(graph, model_card):
    """Of the grasps too, which the nodes of one process hand over as objects."""
    nodes = dict(zip(TOPICS, graph.add("grasp", "touch_predictor", model=model_card), strict=True))
    for node in nodes.values():
        answer(node, *range(1, 13))
    late = {topic: listen_late(graph, topic) for topic in TOPICS}
    volatile = {topic: graph.listen(kind, topic) for topic, kind in TOPICS.items()}
    for topic in TOPICS:
        graph.until(lambda topic=topic: len(late[topic]) == 10)
        graph.matched(topic, subscribers=2)
        answer(nodes[topic], 13)
        graph.until(lambda topic=topic: volatile[topic] and len(late[topic]) == 11)
        assert stamps(late[topic]) == [*range(3, 14)]
        assert stamps(volatile[topic]) == [13]


def test_answers_are_kept_while_a_node_is_inactive_and_until_it_is_cleaned_up(graph):
    (node,) = graph.add("grasp")
    answer(node, 1, 2)
    change(graph, Transition.TRANSITION_DEACTIVATE)
    first = listen_late(graph, "grasps")
    graph.until(lambda: len(first) == 2)
    change(graph, Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
    second = listen_late(graph, "grasps")
    graph.matched("grasps", subscribers=2)
    answer(node, 3)
    graph.until(lambda: len(first) == 3 and second)
    assert (stamps(first), stamps(second)) == ([1, 2, 3], [3])


def test_the_durability_can_be_overridden(graph):
    (node,) = graph.add("grasp", **{"qos_overrides./foretouch/grasps.publisher.durability": "volatile"})
    assert not node._grasps.keeps


def test_a_node_reports_its_matches_at_once(graph):
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    graph.add("grasp", diagnostics_period_s=60.0)

    def values() -> dict[str, str]:
        return {pair.key: pair.value for pair in reports[-1].status[0].values} if reports else {}

    graph.until(lambda: values().get("matched_subscribers./foretouch/grasps") == "0")
    assert float(values()[UPTIME]) < 60.0
    graph.listen(GraspArray, "grasps")
    graph.until(lambda: values()["matched_subscribers./foretouch/grasps"] == "1")


def reported(uptime_s: float, state: str = "active", **ends: int) -> DiagnosticArray:
    """As a predictor reports."""
    values = {"state": state, UPTIME: str(uptime_s), **{f"{kind}.{TOUCH}": str(count) for kind, count in ends.items()}}
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticArray(status=[DiagnosticStatus(name=PREDICTOR, values=pairs)])


@pytest.fixture
def predictor(graph):
    """A node that stands for the predictor of another process, with a volatile publisher."""
    node = Node("touch_predictor", namespace="/foretouch")
    node.create_publisher(TouchPredictionArray, "touch", 10)
    yield node
    node.destroy_node()


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


def test_a_node_that_reports_must_have_reported(graph, predictor):
    matching = Matching(graph.probe, 0.0, ())
    predictor.create_publisher(DiagnosticArray, "/diagnostics", 10)
    graph.until(lambda: matching.missing() == [f"{PREDICTOR}: no report in /diagnostics"])
    matching.receive(reported(1.0, "unconfigured"))  # it has made no publisher yet
    assert matching.missing() == [f"{PREDICTOR}: no report in /diagnostics"]
    matching.receive(reported(1.0))
    assert matching.missing() == []


def test_a_node_must_have_run_long_enough_to_be_discovered(graph):
    matching = Matching(graph.probe, 3.0, ())
    matching.receive(reported(2.0))
    assert not matching.is_discovered()
    matching.receive(reported(3.0))
    assert matching.is_discovered()


def test_a_topic_to_wait_for_needs_a_subscriber_of_another_program(graph):
    matching = Matching(graph.probe, 0.0, ["touch"])
    own = Node("monitor", namespace="/foretouch")
    try:
        own.create_subscription(TouchPredictionArray, "touch", print, 10)
        graph.until(lambda: graph.probe.count_subscribers(TOUCH) == 1)
        assert matching.missing() == [f"{TOUCH}: no subscriber"]
        other = Node("planner")
        try:
            other.create_subscription(TouchPredictionArray, TOUCH, print, 10)
            graph.until(lambda: matching.missing() == [])
        finally:
            other.destroy_node()
    finally:
        own.destroy_node()


def test_a_topic_to_wait_for_must_have_a_name(graph):
    with pytest.raises(ConfigError, match="wait_for: 'a b' is no name of a topic"):
        Matching(graph.probe, 0.0, ["a b"])
