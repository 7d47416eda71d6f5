# SPDX-License-Identifier: Apache-2.0
"""The replay node over real DDS: everything is played once, in order, as recorded, and its end is reported."""

import sys
import time
from types import SimpleNamespace

import depth_builders
import numpy as np
import PIL.Image
import pytest
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String

from foretouch.cloud.io.files import write_cloud
from foretouch.cloud.messages import decode_cloud
from foretouch.dataset.formats.rosbag2 import BagWriter, write_bag
from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings.bag import POINT_CLOUD_TYPE, Recording, Topic
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.source import open_source
from foretouch.errors import ConfigError
from foretouch.ros.nodes.replay import playable
from foretouch.ros.sessions.playlist import Pace, entries
from foretouch.types import CameraModel, Cloud, assumed_table, stamp_ns
from foretouch_msgs.msg import TablePlane, TouchPredictionArray

pytestmark = pytest.mark.ros

STORE = get_typestore(Stores.ROS2_KILTED)
START_NS, STEP_NS = 1_700_000_000_000_000_000, 20_000_000
CLOUDS = {"points": PointCloud2}


def make_clouds(rng, count=5, shape=(6, 8)):
    numbers = rng.normal(size=(count, *shape, 3)).astype(np.float32)
    return [Cloud(xyz, None, "lens", START_NS + k * STEP_NS) for k, xyz in enumerate(numbers)]


@pytest.fixture
def bag(tmp_path, rng):
    """Writes a recording of so many clouds."""

    def write(count=5):
        clouds = make_clouds(rng, count)
        write_bag(tmp_path / "bag", clouds)
        return tmp_path / "bag", clouds

    return write


def text(data):
    return bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](data), "std_msgs/msg/String"))


def start(graph, path, **parameters):
    (node,) = graph.add("replay", path=str(path), **{"discovery_s": 0.0, **parameters})
    return node


def play(graph, path, topics=CLOUDS, **parameters):
    """Replay to the end with a subscriber a topic, and wait until they have what was played."""
    received = {topic: graph.listen(kind, topic) for topic, kind in topics.items()}
    node = start(graph, path, **parameters)
    assert node.ended.wait(20.0)
    for topic, messages in received.items():
        played = node.played[graph.probe.resolve_topic_name(topic)]
        graph.until(lambda messages=messages, played=played: len(messages) >= played)
    return node, received


def stamps(messages):
    return [stamp_ns(message.header.stamp) for message in messages]


def test_every_cloud_is_played_once_in_order_and_in_time_as_recorded_and_the_end_is_kept(graph, bag):
    path, clouds = bag(11)
    node, received = play(graph, path)
    pace = Pace()
    due = [pace.due_s(entry) for entry in entries(open_source(path))]
    np.testing.assert_allclose(due, STEP_NS * 1e-9 * np.arange(11))
    with Recording(path) as recording:
        expected = [deserialize_message(message.data, PointCloud2) for message in recording.messages()]
    assert received["points"] == expected
    for message, cloud in zip(received["points"], clouds, strict=True):
        read = decode_cloud(message)
        assert (read.frame_id, read.stamp_ns) == (cloud.frame_id, cloud.stamp_ns)
        np.testing.assert_array_equal(read.xyz, cloud.xyz)
    assert (node.outcome, dict(node.played)) == ("finished", {"/foretouch/points": 11})
    summary = node.statistics.summary()
    assert (summary.received, summary.used, summary.waiting) == (11, 11, 0)
    values = node.reported().values
    assert (values["replay"], values["clouds"], values["played./foretouch/points"]) == ("finished", "11", "11")


def test_a_recording_that_opens_slowly_keeps_its_pauses(graph, bag, monkeypatch):
    path, _ = bag(3)
    now_s = 0.0

    def opened_slowly(*arguments):
        nonlocal now_s
        now_s += 5.0
        yield from entries(*arguments)

    monkeypatch.setattr("foretouch.ros.nodes.replay.entries", opened_slowly)
    monkeypatch.setattr("foretouch.ros.nodes.replay.time", SimpleNamespace(monotonic=lambda: now_s))
    node, _ = play(graph, path)
    median_ms, _ = node.statistics.summary().input_age_ms
    assert median_ms == pytest.approx(
        -STEP_NS * 1e-6
    )  # the clock stands: each cloud was to wait for its time after the first


@pytest.mark.parametrize("form", ["", "/compressedDepth"])
def test_depth_images_and_their_infos_keep_their_topics(graph, tmp_path, form):
    folder = "/foretouch/depth"  # as the camera node of this package: what a graph publishes itself is else left out
    topic, info_topic, sent = f"{folder}/image_rect_raw{form}", f"{folder}/camera_info", []
    pixels = np.full((480, 848), 700, np.uint16)
    for k in range(3):
        head = {"header": depth_builders.header(stamp_ns=START_NS + k * STEP_NS)}
        message = depth_builders.image(pixels, "16UC1", **head)
        if form:
            message = depth_builders.compressed(depth_builders.png(pixels))
            message.header = head["header"]
        sent += [
            (info_topic, START_NS + k * STEP_NS, depth_builders.info(**head)),
            (topic, START_NS + k * STEP_NS + 1, message),
        ]
    path = depth_builders.write_bag(tmp_path / "bag", sent)
    kinds = {topic: CompressedImage if form else Image, info_topic: CameraInfo}
    node, received = play(graph, path, kinds)
    with Recording(path) as recording:
        for name, kind in kinds.items():
            assert received[name] == [deserialize_message(one.data, kind) for one in recording.messages([name])]
    assert (node.outcome, dict(node.played)) == ("finished", {topic: 3, info_topic: 3})
    assert node.clouds_topic == topic


@pytest.mark.parametrize("restamp", [False, True])
def test_colours_keep_their_topic_and_the_stamp_of_their_depth_image(graph, tmp_path, restamp):
    topics = {
        "/foretouch/depth/image_rect_raw": Image,
        "/foretouch/depth/camera_info": CameraInfo,
        "/foretouch/color/image": Image,
    }
    depth, colour, sent = np.full((480, 848), 700, np.uint16), np.zeros((480, 848, 3), np.uint8), []
    for k in range(3):
        at = START_NS + k * STEP_NS
        head = {"header": depth_builders.header(stamp_ns=at)}
        messages = (
            depth_builders.image(depth, "16UC1", **head),
            depth_builders.info(**head),
            depth_builders.image(colour, "rgb8", step=848 * 3, **head),
        )
        sent += [(topic, at + n, message) for n, (topic, message) in enumerate(zip(topics, messages, strict=True))]
    path = depth_builders.write_bag(tmp_path / "bag", sent)
    node, received = play(graph, path, topics, restamp=restamp)
    assert dict(node.played) == dict.fromkeys(topics, 3)
    images, _, colours = ([stamp_ns(one.header.stamp) for one in received[topic]] for topic in topics)
    assert images == colours
    assert (images == [START_NS + k * STEP_NS for k in range(3)]) != restamp


def test_nothing_is_played_before_subscribers_are_there_but_the_wait_has_a_limit(graph, bag, capfd):
    path, _ = bag()
    node, received = start(graph, path, wait_for=["plans"], wait_limit_s=60.0), []
    for topic, kind, heard in (("points", PointCloud2, received), ("plans", String, [])):
        time.sleep(0.4)
        assert (node.outcome, dict(node.played)) == ("waiting", {})
        graph.probe.create_subscription(kind, topic, heard.append, 100)
    assert node.ended.wait(20.0)
    graph.until(lambda: len(received) == 5)
    graph.remove(node)
    play(graph, path, wait_for=["others"], wait_limit_s=1.2, discovery_s=0.5)
    logged = capfd.readouterr().err
    assert "waits for a subscriber of /foretouch/others" in logged
    assert "plays after 1.2 s, still without a subscriber of /foretouch/others" in logged
    with pytest.raises(ConfigError, match="wait_for: 'a b' is not the name of a topic"):
        start(graph, path, wait_for=["a b"])._setup()


def test_other_topics_are_played_too_and_the_unknown_are_named(graph, tmp_path, rng):
    with BagWriter(tmp_path / "bag") as writer:
        writer.definitions.register("nobodys_msgs/msg/Secret", "int32 x\n")
        for k, cloud in enumerate(make_clouds(rng, count=3)):
            writer.write("/said", "std_msgs/msg/String", cloud.stamp_ns - 1, text(f"word {k}"))
            writer.write("/secret", "nobodys_msgs/msg/Secret", cloud.stamp_ns, b"\0\1\0\0\5\0\0\0")
            writer.write("/foretouch/remark", "std_msgs/msg/String", cloud.stamp_ns, text("of an older graph"))
            writer.write_cloud(cloud)
    node, received = play(graph, tmp_path / "bag", {**CLOUDS, "/said": String})
    assert [message.data for message in received["/said"]] == ["word 0", "word 1", "word 2"]
    assert node.played == {"/foretouch/points": 3, "/said": 3}
    notes = node.reported().values
    assert notes["left_out./secret"] == "type nobodys_msgs/msg/Secret is not installed (3 messages)"
    assert notes["left_out./foretouch/remark"] == "this graph publishes under /foretouch itself (3 messages)"


def test_a_looped_replay_of_an_empty_dataset_ends(graph, tmp_path):
    identity = Identity(hand={"name": "mine"}, camera={"name": "none"})
    RecordingWriter(tmp_path / "empty", identity, RecordingConfig()).close()
    node = start(graph, tmp_path / "empty", loop=True, subscribers=0)
    assert node.ended.wait(20.0)


def test_a_looped_replay_has_increasing_stamps_and_activating_again_plays_from_the_beginning(graph, bag):
    path, clouds = bag(3)
    received = graph.listen(PointCloud2, "points")
    node = start(graph, path, loop=True)
    graph.until(lambda: len(received) >= 8)
    node.trigger_deactivate()
    assert node.outcome == "stopped"
    assert set(np.diff(stamps(received))) == {STEP_NS}
    graph.set(node, loop=False)
    time.sleep(0.1)
    del received[:]
    node.trigger_activate()
    assert node.ended.wait(20.0)
    graph.until(lambda: len(received) == 3)
    assert stamps(received) == [cloud.stamp_ns for cloud in clouds]
    graph.remove(node)
    before = time.time_ns()
    _, restamped = play(graph, path, restamp=True)
    assert before < min(stamps(restamped["points"])) < max(stamps(restamped["points"])) < time.time_ns()
    np.testing.assert_array_equal(decode_cloud(restamped["points"][1]).xyz, clouds[1].xyz)


def test_files_of_objects_are_published_behind_the_segmentation_and_images_before_it(graph, tmp_path, rng):
    for k, cloud in enumerate(make_clouds(rng, count=3, shape=(50,))):
        write_cloud(tmp_path / f"{k}.pcd", cloud)
    (tmp_path / "1.pcd").write_bytes(b"no cloud")
    topics = {"object_cloud": PointCloud2, "table": TablePlane, **CLOUDS}
    node, received = play(graph, tmp_path, topics, table=[0.0, 0.0, -1.0, 1.0], rate_hz=20.0)
    assert [len(received[topic]) for topic in topics] == [2, 2, 0]
    for cloud, table in zip(received["object_cloud"], received["table"], strict=True):
        assert table.header == cloud.header
        assert table.header.frame_id == "camera_depth_optical_frame"
        assert list(table.plane.coef) == [0.0, 0.0, -1.0, 1.0]
    summary = node.statistics.summary()
    assert (summary.received, summary.used, dict(summary.dropped)) == (3, 2, {"unreadable": 1})
    assert node.first_refusal.startswith(f"{tmp_path / '1.pcd'}: ")
    graph.remove(node)
    node, received = play(graph, tmp_path, topics, rate_hz=20.0)  # where the commands assume the table
    for cloud, table in zip(received["object_cloud"], received["table"], strict=True):
        np.testing.assert_array_equal(table.plane.coef, assumed_table(decode_cloud(cloud)).coefficients)
    graph.remove(node)
    (tmp_path / "images").mkdir()
    write_cloud(tmp_path / "images" / "0.npz", make_clouds(rng, 1)[0])
    _, received = play(graph, tmp_path / "images")
    assert [(m.height, m.width) for m in received["points"]] == [(6, 8)]


def test_in_lockstep_a_cloud_waits_for_the_answer_to_the_last_and_a_missing_one_is_counted(graph, bag, monkeypatch):
    path, _ = bag(4)
    outstanding, most, answering = [], [], [True]
    answers = graph.talk(TouchPredictionArray, "touch")

    def answer(message):
        outstanding.append(message)
        most.append(len(outstanding))
        time.sleep(0.05)
        outstanding.clear()
        if answering[0]:
            answers.publish(TouchPredictionArray(header=message.header))

    graph.probe.create_subscription(PointCloud2, "points", answer, 10)
    node = start(graph, path, lockstep=True, rate_hz=1000.0)
    assert node.ended.wait(20.0)
    assert (node.played["/foretouch/points"], node.unanswered, max(most)) == (4, 0, 1)
    answering[0] = False
    monkeypatch.setattr("foretouch.ros.nodes.replay._ANSWER_S", 0.1)
    node.trigger_deactivate()
    node.trigger_activate()
    assert node.ended.wait(20.0)
    assert (node.played["/foretouch/points"], node.reported().values["unanswered"]) == (4, "4")


def test_a_source_that_breaks_off_or_is_none_is_a_failure_with_its_reason(graph, bag, tmp_path, capfd):
    path, _ = bag()
    file = path / "bag.mcap"
    file.write_bytes(file.read_bytes()[:-20])
    node, received = play(graph, path)
    assert (len(received["points"]), node.outcome) == (5, "failed")
    assert f"what is intact was read; `foretouch dataset repair {file}` makes a complete file of it" in node.failure
    assert node.reported().errors == [node.failure]
    for nothing, reason in (("", "path: is empty"), ("/nowhere", "/nowhere: does not exist")):
        node = start(graph, nothing)
        assert node.state_name == "unconfigured"
        assert reason in capfd.readouterr().err
        graph.remove(node)
    with pytest.raises(ConfigError, match=r"table: \[0.0, 0.0, 0.0, 1.0\] is not a plane"):
        start(graph, tmp_path, table=[0.0, 0.0, 0.0, 1.0])


def test_a_pause_of_decades_where_the_clock_was_set_is_cut_and_logged(graph, tmp_path, rng, capfd):
    with BagWriter(tmp_path / "bag") as writer:
        for cloud, time_ns in zip(make_clouds(rng, 4), (0, STEP_NS, START_NS, 2**63 - 1), strict=True):
            writer.write_cloud(cloud, "/points", bag_time_ns=time_ns)
    node, received = play(graph, tmp_path / "bag", longest_pause_s=0.3)
    assert (len(received["points"]), node.outcome) == (4, "finished")
    logged = capfd.readouterr().err
    assert f"/points[2]: {START_NS // 10**9} s of the pause before it are left out" in logged
    assert "/points[3]: " in logged


def test_which_topics_are_playable():
    fields = tuple(PointCloud2.get_fields_and_field_types())
    known = Topic("/cloud", POINT_CLOUD_TYPE, 3, fields)
    others = [
        Topic("/empty", POINT_CLOUD_TYPE, 0, fields),
        Topic("/rosout", "rcl_interfaces/msg/Log", 7),
        Topic("/foretouch/executed_grasp", "foretouch_msgs/msg/ExecutedGrasp", 1, ("header",)),
    ]
    changed = "type foretouch_msgs/msg/ExecutedGrasp had other fields when it was recorded (1 messages)"
    assert playable([known, *others], "/foretouch") == (
        {known: PointCloud2},
        {"/rosout": "reports on running nodes (7 messages)", "/foretouch/executed_grasp": changed},
    )
    for name in ("antigravity/msg/X", "../msg/X", "os.path/msg/X", "", "std_msgs/String"):  # no module is imported
        classes, reasons = playable([Topic("/x", name, 1)], "/foretouch")
        assert (classes, bool(reasons["/x"]), "antigravity" in sys.modules) == ({}, True, False)


def test_depth_files_are_played_as_the_clouds_of_the_stated_camera(graph, tmp_path, rng):
    depth = rng.integers(400, 900, (6, 8), dtype=np.uint16)
    PIL.Image.fromarray(depth).save(tmp_path / "a-depth.png")
    stated = {"intrinsics": [10.0, 11.0, 3.5, 2.5], "depth_scale": 0.002}
    _, received = play(graph, tmp_path, **stated)
    (message,) = received["points"]
    expected = Cloud.from_depth(depth, CameraModel(8, 6, 10.0, 11.0, 3.5, 2.5), 0.002)
    np.testing.assert_array_equal(decode_cloud(message).xyz, expected.xyz)
