# SPDX-License-Identifier: Apache-2.0
"""The replay node over real DDS: everything is played once, in order, as recorded, and the end is told."""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.bag import POINT_CLOUD_TYPE, Recording, Topic
from foretouch.dataset.bag_writer import BagWriter, write_bag
from foretouch.dataset.messages import decode_cloud
from foretouch.errors import ConfigError
from foretouch.ros.nodes.replay import ReplayNode, message_class, playable
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud
from foretouch_msgs.msg import TablePlane, TouchPredictionArray

pytestmark = pytest.mark.ros

STORE = get_typestore(Stores.ROS2_KILTED)
START_NS = 1_700_000_000_000_000_000
STEP_NS = 20_000_000


def make_clouds(rng: np.random.Generator, count: int = 5, shape: tuple[int, ...] = (6, 8)) -> list[Cloud]:
    return [
        Cloud(rng.normal(size=(*shape, 3)).astype(np.float32), None, "lens", START_NS + k * STEP_NS)
        for k in range(count)
    ]


def said(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](text), "std_msgs/msg/String"))


def start(graph, path, **parameters) -> ReplayNode:
    (node,) = graph.add("replay", path=str(path), **{"discovery_s": 0.0, **parameters})
    return node


def play(graph, path, topics: dict[str, type], **parameters) -> tuple[ReplayNode, dict[str, list]]:
    """Replay to the end with a subscriber a topic, and wait until they have what was played."""
    received = {topic: graph.listen(kind, topic) for topic, kind in topics.items()}
    node = start(graph, path, **parameters)
    assert node.ended.wait(20.0)
    for topic, messages in received.items():
        played = node.played[graph.probe.resolve_topic_name(topic)]
        graph.until(lambda messages=messages, played=played: len(messages) >= played)
    return node, received


def test_every_cloud_is_played_once_in_order_as_recorded(graph, tmp_path, rng):
    clouds = make_clouds(rng)
    write_bag(tmp_path / "bag", clouds)
    node, received = play(graph, tmp_path / "bag", {"points": PointCloud2})
    read = [decode_cloud(message) for message in received["points"]]
    assert [(c.frame_id, c.stamp_ns) for c in read] == [(c.frame_id, c.stamp_ns) for c in clouds]
    for one, other in zip(read, clouds, strict=True):
        np.testing.assert_array_equal(one.xyz, other.xyz)
    assert (node.outcome, dict(node.played)) == ("finished", {"/foretouch/points": len(clouds)})
    snapshot = node.statistics.summary()
    assert (snapshot.received, snapshot.used, snapshot.waiting) == (5, 5, 0)


def test_the_recorded_times_are_kept(graph, tmp_path, rng):
    clouds = make_clouds(rng, count=11)
    write_bag(tmp_path / "bag", clouds)
    began = time.monotonic()
    play(graph, tmp_path / "bag", {"points": PointCloud2}, settle_s=0.0)
    assert time.monotonic() - began >= 10 * STEP_NS * 1e-9


def test_nothing_is_played_before_somebody_listens(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng))
    node = start(graph, tmp_path / "bag")
    time.sleep(0.5)
    assert (node.outcome, dict(node.played)) == ("waiting", {})
    received = graph.listen(PointCloud2, "points")
    assert node.ended.wait(20.0)
    graph.until(lambda: len(received) == 5)


def test_nothing_is_played_before_the_named_topic_is_subscribed_to(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng))
    clouds = graph.listen(PointCloud2, "points")
    node = start(graph, tmp_path / "bag", wait_for=["plans"], wait_limit_s=60.0)
    graph.until(lambda: graph.probe.count_publishers("/foretouch/points"))
    time.sleep(0.5)
    assert node.outcome == "waiting"
    graph.listen(String, "plans")
    assert node.ended.wait(20.0)
    graph.until(lambda: len(clouds) == 5)


def test_the_wait_has_a_limit_and_names_what_is_missing(graph, tmp_path, rng, capfd):
    write_bag(tmp_path / "bag", make_clouds(rng))
    play(graph, tmp_path / "bag", {"points": PointCloud2}, wait_for=["plans"], wait_limit_s=1.2)
    told = capfd.readouterr().err
    assert "waits at most 1.2 s for /foretouch/plans: no subscriber" in told
    assert "plays after 1.2 s, still without /foretouch/plans: no subscriber" in told


def test_a_replay_is_discovered_before_it_plays(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng, count=1))
    node, _ = play(graph, tmp_path / "bag", {"points": PointCloud2}, discovery_s=1.5)
    assert node.uptime_s() >= 1.5


def test_the_end_is_told_to_those_who_come_late(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng))
    play(graph, tmp_path / "bag", {"points": PointCloud2})
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    told = []
    graph.probe.create_subscription(DiagnosticStatus, "replay_status", told.append, latched)
    graph.until(lambda: told)
    values = {pair.key: pair.value for pair in told[-1].values}
    assert told[-1].message == "finished"
    assert (values["clouds"], values["played./foretouch/points"]) == ("5", "5")


def test_other_topics_go_along_and_the_unknown_are_named(graph, tmp_path, rng):
    clouds = make_clouds(rng, count=3)
    with BagWriter(tmp_path / "bag") as writer:
        writer.define("nobodys_msgs/msg/Secret", "int32 x\n")
        for k, cloud in enumerate(clouds):
            writer.write("/said", "std_msgs/msg/String", cloud.stamp_ns - 1, said(f"word {k}"))
            writer.write("/secret", "nobodys_msgs/msg/Secret", cloud.stamp_ns, b"\0\1\0\0\5\0\0\0")
            writer.write("/foretouch/remark", "std_msgs/msg/String", cloud.stamp_ns, said("of an older graph"))
            writer.write_cloud(cloud)
    node, received = play(graph, tmp_path / "bag", {"points": PointCloud2, "/said": String})
    assert [message.data for message in received["/said"]] == ["word 0", "word 1", "word 2"]
    assert node.played == {"/foretouch/points": 3, "/said": 3}
    notes = node.notes()
    assert notes["left_out./secret"] == "type nobodys_msgs/msg/Secret is not installed (3 messages)"
    assert notes["left_out./foretouch/remark"] == "this graph publishes under /foretouch itself (3 messages)"


def test_a_looped_replay_goes_on_in_time(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng, count=3))
    received = graph.listen(PointCloud2, "points")
    node = start(graph, tmp_path / "bag", loop=True)
    graph.until(lambda: len(received) >= 8)
    node.trigger_deactivate()
    assert node.outcome == "stopped"
    stamps = [stamp_ns(message.header.stamp) for message in received]
    assert set(np.diff(stamps)) == {STEP_NS}


def test_activating_again_plays_from_the_beginning(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng, count=2))
    node, received = play(graph, tmp_path / "bag", {"points": PointCloud2})
    node.trigger_deactivate()
    node.trigger_activate()
    assert node.ended.wait(20.0)
    graph.until(lambda: len(received["points"]) == 4)
    assert len({stamp_ns(m.header.stamp) for m in received["points"]}) == 2


def test_restamped_clouds_carry_the_time_of_now_and_the_same_points(graph, tmp_path, rng):
    clouds = make_clouds(rng, count=2)
    write_bag(tmp_path / "bag", clouds)
    before = time.time_ns()
    _, received = play(graph, tmp_path / "bag", {"points": PointCloud2}, restamp=True)
    stamps = [stamp_ns(message.header.stamp) for message in received["points"]]
    assert before < stamps[0] < stamps[1] < time.time_ns()
    np.testing.assert_array_equal(decode_cloud(received["points"][1]).xyz, clouds[1].xyz)


def test_folders_of_objects_go_behind_the_segmentation(graph, tmp_path, rng):
    for k, cloud in enumerate(make_clouds(rng, count=3, shape=(50,))):
        write_cloud(tmp_path / f"{k}.pcd", cloud)
    (tmp_path / "1.pcd").write_bytes(b"no cloud")
    topics = {"object_cloud": PointCloud2, "table": TablePlane, "points": PointCloud2}
    node, received = play(graph, tmp_path, topics, table=[0.0, 0.0, -1.0, 1.0], rate_hz=20.0)
    assert not received["points"]
    assert [len(received[topic]) for topic in ("object_cloud", "table")] == [2, 2]
    for cloud, table in zip(received["object_cloud"], received["table"], strict=True):
        assert table.header == cloud.header
        assert table.header.frame_id == "camera_depth_optical_frame"
        assert list(table.plane.coef) == [0.0, 0.0, -1.0, 1.0]
    snapshot = node.statistics.summary()
    assert (snapshot.received, snapshot.used, dict(snapshot.dropped)) == (3, 2, {"unreadable": 1})
    assert node.unreadable == 1


def test_folders_of_images_are_to_be_segmented(graph, tmp_path, rng):
    for k, cloud in enumerate(make_clouds(rng, count=2)):
        write_cloud(tmp_path / f"{k}.npz", cloud)
    _, received = play(graph, tmp_path, {"points": PointCloud2})
    assert [(m.height, m.width) for m in received["points"]] == [(6, 8), (6, 8)]


def test_in_lockstep_a_cloud_waits_for_the_answer_to_the_last(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng, count=4))
    outstanding, most = [], []
    answers = graph.probe.create_publisher(TouchPredictionArray, "touch", 10)

    def answer(message: PointCloud2) -> None:
        outstanding.append(message)
        most.append(len(outstanding))
        time.sleep(0.05)
        outstanding.clear()
        answers.publish(TouchPredictionArray(header=message.header))

    graph.probe.create_subscription(PointCloud2, "points", answer, 10)
    node = start(graph, tmp_path / "bag", lockstep=True, rate_hz=1000.0)
    assert node.ended.wait(20.0)
    assert (node.played["/foretouch/points"], node.unanswered, max(most)) == (4, 0, 1)


def test_in_lockstep_a_missing_answer_is_counted_and_the_rest_goes_on(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng, count=2))
    graph.probe.create_publisher(TouchPredictionArray, "touch", 10)
    node, received = play(
        graph, tmp_path / "bag", {"points": PointCloud2}, lockstep=True, answer_timeout_s=0.1, settle_s=0.3
    )
    assert (len(received["points"]), node.unanswered, node.notes()["unanswered"]) == (2, 2, "2")


def test_a_recording_that_breaks_off_is_a_failure_with_its_reason(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng))
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 5", "message_count: 6"))
    node, received = play(graph, tmp_path / "bag", {"points": PointCloud2})
    assert (len(received["points"]), node.outcome) == (5, "failed")
    assert "declares 6 messages, holds 5" in node.reason
    assert node.errors() == (node.reason,)


@pytest.mark.parametrize(
    ("parameters", "told"), [({"path": ""}, "path: is empty"), ({"path": "/nowhere"}, "/nowhere: does not exist")]
)
def test_a_source_that_is_none_refuses_to_configure(graph, capfd, parameters, told):
    (node,) = graph.add("replay", **parameters)
    assert node.state_name == "unconfigured"
    assert told in capfd.readouterr().err


def test_a_table_that_is_no_plane_is_refused(graph, tmp_path):
    with pytest.raises(ConfigError, match=r"table: \[0.0, 0.0, 0.0, 1.0\] is not a plane"):
        start(graph, tmp_path, table=[0.0, 0.0, 0.0, 1.0])


def test_raw_bytes_are_what_the_recording_holds(graph, tmp_path, rng):
    write_bag(tmp_path / "bag", make_clouds(rng, count=1))
    with Recording(tmp_path / "bag") as recording:
        (message,) = recording.messages()
    _, received = play(graph, tmp_path / "bag", {"points": PointCloud2})
    assert received["points"][0] == deserialize_message(message.data, PointCloud2)


def test_which_topics_are_playable():
    fields = tuple(PointCloud2.get_fields_and_field_types())
    known = Topic("/cloud", POINT_CLOUD_TYPE, 3, fields)
    classes, reasons = playable(
        [
            known,
            Topic("/empty", POINT_CLOUD_TYPE, 0, fields),
            Topic("/rosout", "rcl_interfaces/msg/Log", 7),
            Topic("/foretouch/executed_grasp", "foretouch_msgs/msg/ExecutedGrasp", 1, ("header",)),
        ],
        "/foretouch",
    )
    assert classes == {known: PointCloud2}
    assert reasons == {
        "/rosout": "reports on running nodes (7 messages)",
        "/foretouch/executed_grasp": "type foretouch_msgs/msg/ExecutedGrasp had other fields when it was recorded"
        " (1 messages)",
    }


@pytest.mark.parametrize("name", ["antigravity/msg/X", "../msg/X", "os.path/msg/X", "", "std_msgs/String"])
def test_a_recording_cannot_make_us_import_what_is_no_message(name):
    found, reason = message_class(Topic("/x", name, 1))
    assert found is None
    assert reason
    assert "antigravity" not in sys.modules
