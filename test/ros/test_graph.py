# SPDX-License-Identifier: Apache-2.0
"""What `--source TOPIC` makes of the topics that are published."""

from types import SimpleNamespace

import pytest
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from foretouch.ros.graph import Graph

pytestmark = pytest.mark.ros

LOOK = """
from foretouch.errors import ConfigError
from foretouch.ros.graph import input_of
for topic in {topics}:
    try:
        print(input_of(topic, {wait_s}))
    except ConfigError as err:
        print(err)
"""


def test_a_topic_is_depth_or_points_by_its_type_and_another_is_named_with_what_there_is(lone_graph):
    def look(wait_s, *topics):
        printed, _ = lone_graph.start(LOOK.format(topics=topics, wait_s=wait_s)).communicate(timeout=40.0)
        return printed.splitlines()

    nothing = "no images or clouds are published here: start the driver of the camera, with the same ROS_DOMAIN_ID"
    assert look(0.5, "/depth") == [f"/depth: no node published it within 0.5 s; {nothing}"]
    for kind, topic in ((Image, "/raw"), (CompressedImage, "/raw/compressedDepth"), (PointCloud2, "/points")):
        lone_graph.talk(kind, topic)
    lone_graph.talk(CameraInfo, "/info")
    published = "images and clouds are published on /points, /raw, /raw/compressedDepth"
    info = f"/info: is a sensor_msgs/msg/CameraInfo; {published}"
    assert look(5.0, "/raw", "/raw/compressedDepth", "/points", "/info") == ["depth", "depth", "points", info]


def test_of_a_topic_of_others_no_answer_is_counted_after_the_end():
    graph, closed = Graph({}), []
    counts = SimpleNamespace(received=5)
    graph.nodes = {"perception": SimpleNamespace(statistics=SimpleNamespace(summary=lambda: counts))}
    graph.monitor = SimpleNamespace(close_view=lambda: closed.append(counts.received))
    graph.stop_source()
    counts.received = 9
    assert (closed, graph.played()) == ([5], 5)
