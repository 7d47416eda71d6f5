# SPDX-License-Identifier: Apache-2.0
"""What is taken through rcl is what rclpy takes, and the points of a cloud live as long as they are used."""

import array
import gc
import time
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.requests import read_cloud
from foretouch.ros.runtime import take as module
from foretouch.ros.runtime.take import take
from foretouch.types import Cloud
from foretouch_msgs.msg import Grasp, GraspArray
from test.every_case import every_case
from test.ros.conftest import open_domain

pytestmark = pytest.mark.ros
EMPTY = PointCloud2(height=1, point_step=12, fields=[PointField(name=name, datatype=7, count=1) for name in "xyz"])


@pytest.fixture
def ends():
    """A publisher of clouds, and two subscriptions to them."""
    open_domain(new=False)
    node = Node("take")
    profile = QoSProfile(depth=10)
    publisher = node.create_publisher(PointCloud2, "cloud", profile)
    publisher.node = node
    ours, theirs = (node.create_subscription(PointCloud2, "cloud", print, profile) for _ in range(2))
    yield publisher, ours, theirs
    node.destroy_node()


def taken(call):
    """What a call gives, once there is something to take."""
    for _ in range(1000):
        if (found := call()) is not None:
            return found
        time.sleep(0.005)
    raise AssertionError("nothing came")


def made(rng, shape, frame, *, coloured=False):
    rgb = rng.integers(0, 256, (*shape, 3), np.uint8) if coloured else None
    message = cloud_to_msg(Cloud(rng.normal(size=(*shape, 3)).astype(np.float32), rgb, frame))
    message.header.stamp.sec, message.header.stamp.nanosec = 2_000_000_001, 999_999_999
    return message


def test_it_is_the_message_and_the_information_that_rclpy_gives(ends, rng):
    publisher, ours, theirs = ends
    cases = {f"frame of {n} letters": made(rng, (2, 3), "f" * n) for n in range(6)}
    cases |= {"coloured": made(rng, (4, 5), "camera", coloured=True), "a list": made(rng, (7,), "camera")}
    cases |= {"848x480": made(rng, (480, 848), "camera"), "no points": EMPTY, "no fields": PointCloud2()}
    cases["other fields"] = PointCloud2(
        width=1, data=array.array("B", range(7)), is_dense=True,
        fields=[PointField(name="ab" * n, offset=n, datatype=n, count=n) for n in range(4)],
    )  # fmt: skip

    def check(message):
        publisher.publish(message)
        (got, info), (expected, known) = (
            taken(lambda: take(ours)),
            taken(lambda: theirs.handle.take_message(PointCloud2, False)),
        )
        assert bytes(got.data) == expected.data.tobytes()
        assert again(got) == again(expected) == again(message)
        same_information(publisher, info, known)

    every_case(cases, check)
    assert take(ours) is None


def again(message):
    """As rclpy reads it: the bytes between two fields of a serialised message are whatever the memory held before."""
    return deserialize_message(serialize_message(message), PointCloud2)


def same_information(publisher, info, known):
    """What rclpy passes beside the message that another subscription takes, and the publisher that discovery lists."""
    listed = publisher.node.get_publishers_info_by_topic(publisher.topic_name)
    assert [bytes(end.endpoint_gid)[:16] for end in listed] == [info["publisher_gid"]["data"]]
    same = ("source_timestamp", "publication_sequence_number")
    assert [info[key] for key in same] == [known[key] for key in same]
    assert 0 < info["received_timestamp"] - info["source_timestamp"] < 60e9


def test_the_points_stay_as_long_as_they_are_used(ends, rng):
    publisher, ours, _ = ends
    messages = [made(rng, (48, 84), "camera") for _ in range(7)]
    for message in messages:
        publisher.publish(message)
    clouds = [read_cloud(taken(lambda: take(ours))[0]) for _ in messages]
    gc.collect()
    for cloud, message in zip(clouds, messages, strict=True):
        assert cloud.xyz.tobytes() == message.data.tobytes()
        assert not cloud.xyz.flags.writeable


def test_an_error_of_rcl_is_one_and_damaged_bytes_are_no_message(ends, rng, monkeypatch):
    _, ours, _ = ends
    monkeypatch.setattr(module, "_rcl", SimpleNamespace(rcl_take_serialized_message=lambda *_: 1))
    with pytest.raises(RuntimeError, match="/cloud: a message cannot be taken: rcl's error 1"):
        take(ours)
    whole = np.frombuffer(serialize_message(made(rng, (2, 3), "camera")), np.uint8)
    for end in range(len(whole) - 4):  # of the padding
        assert module._read(whole[:end], PointCloud2) is None
    for at in range(len(whole)):
        damaged = np.concatenate([whole[:at], rng.integers(0, 256, 1, np.uint8), whole[at + 1 :]])
        module._read(damaged, PointCloud2)  # no error
    whole = np.frombuffer(serialize_message(GraspArray(grasps=[Grasp(id="one")])), np.uint8)
    assert [module._read(whole[:end], GraspArray) for end in range(4, len(whole) - 16)] == [None] * (len(whole) - 20)
