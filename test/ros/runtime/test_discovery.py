# SPDX-License-Identifier: Apache-2.0
"""What late subscribers get, and two graphs in one namespace, over real DDS."""

import json
import subprocess
import sys

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from foretouch.dataset.bag_writer import write_bag
from foretouch.ros.graph import PERCEPTION
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import GraspArray, Status, TouchPredictionArray

pytestmark = pytest.mark.ros

TOPICS = {"grasps": GraspArray, "touch": TouchPredictionArray}
LATE = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


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
    graph.matched("grasps", subscribers=2)
    graph.matched("touch", subscribers=2)
    for topic in TOPICS:
        answer(nodes[topic], 13)
        graph.until(lambda topic=topic: volatile[topic] and len(late[topic]) == 11)
        assert stamps(late[topic]) == [*range(3, 14)]
        assert stamps(volatile[topic]) == [13]


def test_answers_of_a_node_of_another_name_are_reported(graph):
    node, touch = graph.add("segmentation", "touch_predictor", model="none")
    publisher = graph.talk(TouchPredictionArray, "touch")
    text = "/foretouch/touch has 2 publishers: /foretouch/probe, /foretouch/touch_predictor"
    graph.until(lambda: touch.conflicts == (text,))
    assert node.conflicts == ()
    graph.probe.destroy_publisher(publisher)
    graph.until(lambda: touch.conflicts == ())


@pytest.mark.slow
def test_run_prints_that_another_graph_answers_too(lone_graph, tmp_path, scene_cloud, model_card):
    write_bag(tmp_path / "recording", [scene_cloud(stamp_ns=stamp, width=212) for stamp in (1, 2)])
    nodes = lone_graph.add(*PERCEPTION, model=model_card)
    words = ["run", "--source", str(tmp_path / "recording"), "--model", model_card, "--json"]
    command = [sys.executable, "-m", "foretouch", *words]
    done = subprocess.run(
        command, env=lone_graph.environment(), capture_output=True, text=True, timeout=60, check=False
    )
    counts = json.loads(done.stdout.splitlines()[-1])
    assert counts["answered"] > counts["played"] == 2
    line = next(line for line in done.stderr.splitlines() if line.startswith("foretouch: a second graph"))
    for name in PERCEPTION:
        assert f"2 nodes are named /foretouch/{name}" in line
        assert f"2 nodes are named /foretouch/{name}" in counts["conflicts"]
    lone_graph.until(lambda: all(node.past_conflicts and not node.conflicts for node in nodes))
