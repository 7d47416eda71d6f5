# SPDX-License-Identifier: Apache-2.0
"""What late subscribers get, and two graphs in one namespace, over real DDS."""

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from foretouch.types import stamp_ns
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
