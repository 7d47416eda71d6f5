# SPDX-License-Identifier: Apache-2.0
"""Messages handed over within a process: the same answers and counts as over DDS."""

import threading

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from foretouch.ros.graph import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud
from foretouch_msgs.msg import GraspArray, ObjectArray, TablePlane, TouchPredictionArray

pytestmark = pytest.mark.ros

OUTPUTS = {"objects": ObjectArray, "table": TablePlane, "object_cloud": PointCloud2, "grasps": GraspArray,
           "touch": TouchPredictionArray}  # fmt: skip
RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class Outsider:
    """A node in a participant of its own, as one in another process: hears serialised messages."""

    def __init__(self, domain):
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("outsider", namespace="/foretouch", context=self.context)
        self.heard, self.numbers = {}, {}
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def listen(self, topic):
        heard, numbers = self.heard.setdefault(topic, []), self.numbers.setdefault(topic, [])

        def receive(data, info):
            numbers.append(info["publication_sequence_number"])
            heard.append(data)

        self.node.create_subscription(OUTPUTS[topic], topic, receive, RELIABLE, raw=True)

    def close(self):
        self.executor.shutdown(timeout_sec=2.0)
        self._thread.join(5.0)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def _serve(self):
        while self.context.ok() and not self.executor._is_shutdown:
            self.executor.spin_once(timeout_sec=0.2)


@pytest.fixture
def outsider(graph):
    one = Outsider(graph.domain)
    yield one
    one.close()


def settle(graph, nodes, received):
    """Wait until nothing is on its way any more; gives the counts of each node's inputs."""
    graph.until(lambda: nodes[0].statistics.summary().received == received)
    graph.until(lambda: all(node.statistics.summary().waiting == 0 for node in nodes))
    summaries = [node.statistics.summary() for node in nodes]
    return [(one.received, one.used, dict(one.dropped), one.lost) for one in summaries]


def content(topic, data):
    """Every number of a message; its bytes hold gaps, which the middleware leaves as they were."""
    message = deserialize_message(data, OUTPUTS[topic])
    for one in getattr(message, "predictions", ()):
        one.input_age.sec = one.input_age.nanosec = 0
    with np.printoptions(floatmode="unique", threshold=10**9):
        return str(message)


def test_another_participant_gets_the_same_content_and_the_counts_are_the_same(graph, scene_cloud, model_card):
    clouds = [scene_cloud(seed, stamp_ns=7 + seed, n_objects=3) for seed in range(3)]
    clouds.append(Cloud(clouds[0].xyz[:0].reshape(0, 3), None, "cam", 77))  # refused
    publisher, found = graph.talk(PointCloud2, "points"), []
    for direct in (True, False):
        outsider = Outsider(graph.domain)
        nodes = graph.add(*PERCEPTION, model=model_card, direct=direct, target__mode="all", grasp__count=3)
        for topic in OUTPUTS:
            outsider.listen(topic)
            graph.until(lambda topic=topic, one=outsider: one.node.count_publishers(f"/foretouch/{topic}") == 1)
            graph.matched(topic)
        graph.matched("points")
        for number, cloud in enumerate(clouds, 1):
            publisher.publish(cloud_to_msg(cloud))
            graph.until(lambda n=number, one=outsider: all(len(heard) >= n for heard in one.heard.values()))
        counts = settle(graph, nodes, len(clouds)), [node.notes() for node in nodes]
        heard = {topic: [content(topic, data) for data in messages] for topic, messages in outsider.heard.items()}
        found.append((heard, counts))
        outsider.close()
        graph.remove(*nodes)
    (heard_on, counts_on), (heard_off, counts_off) = found
    for topic in OUTPUTS:
        assert len(heard_on[topic]) == len(clouds), topic
        assert heard_on[topic] == heard_off[topic], topic
    assert counts_on == counts_off
    assert heard_on["touch"][0].count("scalars=") > 3  # of several objects


def test_topics_without_other_subscribers_are_not_sent(graph, outsider, scene_cloud, model_card):
    nodes = graph.add(*PERCEPTION, model=model_card)
    outsider.listen("touch")
    publisher = graph.talk_matched(PointCloud2, "points")
    graph.until(lambda: outsider.node.count_publishers("/foretouch/touch"))
    graph.until(lambda: nodes[2]._touch.get_subscription_count() == 1)
    for stamp in (1, 2, 3):
        publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=stamp)))
        graph.until(lambda stamp=stamp: len(outsider.heard["touch"]) == stamp)
    outsider.listen("table")  # from now on it is
    outsider.listen("object_cloud")
    graph.until(lambda: nodes[0]._table.get_subscription_count() == 3)
    graph.until(lambda: nodes[0]._object_cloud.get_subscription_count() == 3)
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=4)))
    graph.until(lambda: outsider.heard["object_cloud"] and outsider.heard["table"])
    assert outsider.numbers["table"] == outsider.numbers["object_cloud"] == [1]  # the first that was sent
    assert [used for _, used, *_ in settle(graph, nodes, 4)] == [4, 4, 4]
    assert outsider.node.count_subscribers("/foretouch/table") == 3  # tools show who subscribes


@pytest.mark.parametrize("direct", [True, False])
def test_a_node_deactivated_in_the_middle_counts_its_clouds(graph, scene_cloud, model_card, direct):
    nodes = graph.add(*PERCEPTION, model=model_card, direct=direct)
    heard, publisher = graph.listen(TouchPredictionArray, "touch"), graph.talk(PointCloud2, "points")
    graph.matched("points", "touch")
    graph.matched("object_cloud", subscribers=2)

    def send(stamp):
        publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=stamp)))
        settle(graph, nodes[:1], stamp)

    send(1)
    graph.until(lambda: len(heard) == 1)
    nodes[1].trigger_deactivate()
    send(2)
    send(3)
    graph.until(lambda: nodes[1].statistics.summary().dropped == {"inactive": 2})
    nodes[1].trigger_activate()
    send(4)
    graph.until(lambda: len(heard) == 2)
    assert [stamp_ns(message.header.stamp) for message in heard] == [1, 4]
    graph.until(lambda: nodes[2].statistics.summary().used == 2)
    summaries = [node.statistics.summary() for node in nodes]
    counts = [(one.received, one.used, dict(one.dropped)) for one in summaries]
    assert counts == [(4, 4, {}), (4, 2, {"inactive": 2}), (4, 2, {})]  # the last has two clouds without grasps


def test_a_publisher_of_another_process_is_still_heard(graph, outsider, scene_cloud, model_card):
    """Its clouds are answered beside those of the node of this process, none of which is answered twice."""
    nodes = graph.add(*PERCEPTION, model=model_card)
    heard, taken, tables = (graph.listen(OUTPUTS[topic], topic) for topic in ("touch", "object_cloud", "table"))
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points", "touch", "table", "object_cloud")
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=1)))
    graph.until(lambda: len(heard) == 1 and taken and tables)
    foreign = {one: outsider.node.create_publisher(OUTPUTS[one], one, RELIABLE) for one in ("table", "object_cloud")}
    for topic, one in foreign.items():
        graph.until(lambda one=one: one.get_subscription_count() == 3)
        graph.until(lambda topic=topic: graph.probe.count_publishers(f"/foretouch/{topic}") == 2)
    for stamp in (10, 11):
        for topic, message in (("table", tables[0]), ("object_cloud", taken[0])):
            message.header.stamp.nanosec = stamp
            foreign[topic].publish(message)
        graph.until(lambda stamp=stamp: stamp in [m.header.stamp.nanosec for m in heard])
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=2)))
    graph.until(lambda: len(heard) == 4)
    assert settle(graph, nodes, 2) == [(2, 2, {}, 0), (4, 4, {}, 0), (4, 4, {}, 0)]
    assert sorted(message.header.stamp.nanosec for message in heard) == [1, 2, 10, 11]
