# SPDX-License-Identifier: Apache-2.0
"""The bridge over a real WebSocket: what a client reads is what the graph published."""

import json
import re
import socket
from pathlib import Path

import numpy as np
import pytest
from constant_models import constant_model, counted

pytest.importorskip("foxglove", reason="the Foxglove SDK is not installed: pip install 'foretouch[serve]'")

from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import PointCloud2
from websocket_client import WebSocketClient

from foretouch import reading
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.tactile.description import packaged_sensor
from foretouch.tactile.messages.biotac import FINGER_ORDER
from foretouch.topics import CLOUD_TOPIC, TACTILE_TOPIC, full_name
from foretouch.types import stamp_ns
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros

TOUCH, POINTS, MARKERS = "/foretouch/touch", "/foretouch/points", "/foretouch/markers"


def decoded(client, topic, content):
    """A message decoded by rosbags, with nothing but the definition that the server sent."""
    channel = client.channels[topic]
    assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return store.deserialize_cdr(content, channel["schemaName"])


def subscribed(graph, node, client, *topics):
    client.subscribe(*topics)
    graph.until(lambda: set(topics) <= set(node.reported().values["topics"].split()))
    for topic in topics:
        graph.until(lambda topic=topic: graph.probe.count_subscribers(topic) > 0)


def test_a_client_reads_what_the_graph_predicts(graph, scene_cloud, monkeypatch):
    sensor = packaged_sensor("xela_uskin_4x4")
    model = constant_model(sensor, counted(sensor))
    monkeypatch.setattr("foretouch.ros.steps.predictor.load_model", lambda *_: model)
    heard = graph.listen(TouchPredictionArray, "touch")
    _, bridge = graph.add("perception", "bridge", port=0, cloud_kb=100_000)  # whole clouds
    publisher = graph.talk(PointCloud2, "points")
    with WebSocketClient(bridge.url) as client:
        subscribed(graph, bridge, client, TOUCH, POINTS, MARKERS)
        graph.matched("points", subscribers=2)
        graph.matched("touch")
        stamps = [1_700_000_000_000_000_000 + k for k in range(3)]
        clouds = [scene_cloud(k, stamp_ns=stamp) for k, stamp in enumerate(stamps)]
        for k, cloud in enumerate(clouds):
            publisher.publish(cloud_to_msg(cloud))
            graph.until(lambda wanted=k + 1: len(heard) >= wanted)
        received = {TOUCH: [], POINTS: [], MARKERS: []}
        while len(received[TOUCH]) < 3 or len(received[POINTS]) < 3 or not received[MARKERS]:
            topic, content = client.next_data()
            received[topic].append(decoded(client, topic, content))
    assert [stamp_ns(one.header.stamp) for one in received[TOUCH]] == stamps
    for mine, theirs in zip(heard, received[TOUCH], strict=True):
        (expected,), (found,) = mine.predictions, theirs.predictions
        assert found.sensor == sensor.config.name
        for end in ("value", "lower", "upper"):
            np.testing.assert_array_equal(getattr(reading(found), end).values, getattr(reading(expected), end).values)
        assert (found.grasp.g1.x, found.model) == (expected.grasp.g1.x, expected.model)
    for cloud, message in zip(clouds, received[POINTS], strict=True):
        assert (message.height, message.width) == cloud.xyz.shape[:2]
        xyz = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_step)[:, :12].copy().view(np.float32)
        np.testing.assert_array_equal(xyz, cloud.xyz.reshape(-1, 3))
    assert all(marker.header.frame_id for one in received[MARKERS] for marker in one.markers)


def test_it_subscribes_only_to_what_a_client_asks_for(graph):
    (bridge,) = graph.add("bridge", port=0)
    assert graph.probe.count_subscribers(POINTS) == 0
    with WebSocketClient(bridge.url) as client:
        client.learn(TOUCH, POINTS, "/diagnostics", "/rh/tactile")
        subscribed(graph, bridge, client, TOUCH)
        assert bridge.reported().values["topics"] == TOUCH
        client.unsubscribe_all()
        graph.until(lambda: graph.probe.count_subscribers(TOUCH) == 0)
        client.subscribe(POINTS)
        graph.until(lambda: graph.probe.count_subscribers(POINTS) == 1)
    graph.until(lambda: graph.probe.count_subscribers(POINTS) == 0)
    assert bridge.statistics.summary().waiting == 0


def test_it_listens_on_this_machine_alone_serves_again_after_a_stop_and_names_a_taken_port(graph, capfd):
    (bridge,) = graph.add("bridge", port=0)
    first, port = bridge.url, int(bridge.url.rpartition(":")[2])
    assert bridge.url == f"ws://127.0.0.1:{port}"
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    ends = [line[1].split(":") for line in listening if line[3] == "0A"]
    assert {address for address, number in ends if int(number, 16) == port} == {"0100007F"}
    bridge.trigger_deactivate()
    assert bridge.url == ""
    with pytest.raises(ConnectionError):
        WebSocketClient(first)
    bridge.trigger_activate()
    with WebSocketClient(bridge.url) as client:
        client.learn(TOUCH)
    graph.remove(bridge)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        (bridge,) = graph.add("bridge", port=port)
        assert bridge.state_name == "inactive"
    graph.until(lambda: f"127.0.0.1:{port}: " in capfd.readouterr().err)


def test_of_a_large_cloud_every_nth_point_is_served():
    from foretouch.ros.nodes.bridge import thinned

    rows = np.arange(6 * 10 * 4, dtype=np.float32).reshape(6, 10, 4)  # the last column of a row is padding of 16 bytes
    cloud = PointCloud2(height=6, width=9, point_step=16, row_step=160, data=rows.tobytes())
    cloud.header.frame_id = "camera"
    content = serialize_message(cloud)
    small = deserialize_message(thinned(content, 300), PointCloud2)  # 54 points of 16 bytes: every third is 288 bytes
    assert (small.height, small.width, small.row_step, small.header.frame_id) == (1, 18, 288, "camera")
    kept = np.frombuffer(small.data, np.float32).reshape(-1, 4)
    assert np.array_equal(kept, rows[:, :9].reshape(-1, 4)[::3])
    assert thinned(content, 864) == content


def test_the_layout_shows_topics_of_the_graph_and_both_fingers():
    text = (Path(__file__).parents[3] / "config" / "foxglove.json").read_text(encoding="utf-8")
    thumb, middle = (FINGER_ORDER.index(name) for name in ("TH", "MF"))
    read = {f"{TACTILE_TOPIC}.tactiles[{index}].pdc" for index in (thumb, middle)}
    keys = ("value", "lower", "upper")
    predicted = {f"{TOUCH}.predictions[0].pdc_{name}.{key}" for name in ("th", "mf") for key in keys}
    shown = set(re.findall(r'"(/[^"]*)"', json.dumps(json.loads(text))))
    assert shown == {POINTS, MARKERS, TOUCH, full_name(CLOUD_TOPIC), *read, *predicted}
