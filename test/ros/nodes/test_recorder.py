# SPDX-License-Identifier: Apache-2.0
"""The recorder over real DDS: a hand that reads what we know, and what of it is found in the file."""

import time

import depth_builders
import numpy as np
import pytest
from pair_builders import REST, level
from robot_builders import MS, QUICK, accounts, outcomes, start
from sensor_msgs.msg import CameraInfo, Image

from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.source import open_source
from foretouch.errors import ConfigError
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.nodes.recorder import RecorderConfig
from foretouch.types import HOLD, Cloud
from foretouch.types.camera import CameraModel
from foretouch_lab.ros.hand_messages import biotac_all_to_msg
from foretouch_msgs.msg import BiotacAll
from foretouch_msgs.srv import LabelGrasp, StartRecording, StopRecording

pytestmark = pytest.mark.ros


def test_grasps_become_samples_with_their_own_cloud_and_touch_and_every_message_is_accounted(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set")
    clouds = []
    for number in range(3):
        robot.record(f"g-{number}", number)
        clouds.append(robot.cloud)
    graph.until(lambda: sum(topic.received for topic in node.status().topics) == sum(robot.sent.values()))
    answer = graph.call(StopRecording, "stop_recording")
    assert (answer.success, answer.samples, answer.path) == (True, 3, str(tmp_path / "set"))

    status = node.status()
    for topic, sent in robot.sent.items():
        one = accounts(status)[topic]
        assert (one.received, one.written, list(one.drop_reasons), one.lost, one.waiting) == (sent, sent, [], 0, 0)
        assert one.reliable
    assert status.received == status.used == sum(robot.sent.values())
    assert outcomes(status) == {"recorded": 3}
    states = dict(zip(status.sensors, status.sensor_states, strict=True))
    assert states == dict.fromkeys(("TH", "MF", "camera"), "alive")

    (report,) = verify_dataset(tmp_path / "set")
    assert not report.faults
    dataset = RecordedDataset(tmp_path / "set")
    assert dataset.identity.hand["thumb"] == "TH"
    for number, sample in enumerate(dataset):
        assert sample.id == f"can/00000{number + 1}"
        np.testing.assert_array_equal(sample.cloud.xyz, clouds[number].xyz)
        np.testing.assert_allclose(sample.touch.values, level(number), atol=5.0)
        np.testing.assert_allclose(sample.tare.values, REST, atol=5.0)
        assert (sample.grasp.id, [g.id for g in sample.candidates]) == (f"g-{number}", [f"g-{number} too"])
        assert (sample.outcome, sample.flags, sample.pairing_error_ns) == ("success", (), 10 * MS)
        assert (sample.series.phases == HOLD).sum() == 20
        assert sample.contact_ns == sample.stamp_ns


def test_a_label_marks_a_grasp_that_the_robot_does_not_report(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set")
    graph.until(lambda: node.recording)
    robot.see("g-0")
    graph.until(lambda: accounts(node.status())["grasps"].written)
    request = LabelGrasp.Request(object="cup", note="slipped", outcome=LabelGrasp.Request.FAILURE)
    answer = graph.call(LabelGrasp, "label_grasp", request)
    assert (answer.success, answer.grasp_id, answer.message) == (True, "g-0", "waits for its contact")
    robot.now += MS
    for counts, readings in ((REST, 120), (level(1), 80), (REST, 20)):
        robot.feel(counts, readings)
    graph.until(lambda: node.status().samples == 1)
    late = graph.call(LabelGrasp, "label_grasp", LabelGrasp.Request(grasp_id="g-0"))
    reason = "grasp g-0: is recorded already; `edit_grasp` changes it"
    assert (late.success, late.message) == (False, reason)
    node.end()
    record = RecordedDataset(tmp_path / "set")[0]
    assert (record.object, record.note, record.outcome) == ("cup", "slipped", "failure")
    assert record.flags == ("detected_interval",)
    np.testing.assert_allclose(record.touch.values, level(1), atol=5.0)


def test_a_dataset_is_extended_and_one_of_another_hand_is_refused(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set")
    begin = lambda **fields: graph.call(StartRecording, "start_recording", StartRecording.Request(**fields))  # noqa: E731
    robot.record("g-0", 0)
    busy = begin(path=str(tmp_path / "other"))
    assert (busy.success, busy.message) == (False, f"{tmp_path / 'set'} is being recorded; stop it first")
    node.end()
    assert begin(path=str(tmp_path / "set"), object="x").success
    robot.record("g-1", 1)
    node.end()
    assert [one.id for one in RecordedDataset(tmp_path / "set")] == ["can/000001", "x/000002"]
    bad = begin(path="y", object="../x")
    assert (bad.success, "is not a plain name" in bad.message) == (False, True)
    (tmp_path / "link").symlink_to("..")
    for path in ("..", "../..", "link/set", "/tmp", str(tmp_path), f"{tmp_path}2/set"):
        outside = begin(path=path)
        assert (outside.success, f"is not inside of the folder {tmp_path}" in outside.message) == (False, True), path
    graph.remove(node)
    (other,) = graph.add("recorder", identity__hand_serial="1234")
    with pytest.raises(Exception, match=r"hand\.serial: .* there, 1234 here"):
        other.begin(str(tmp_path / "set"))


def test_a_best_effort_sensor_is_heard_and_its_dead_electrodes_are_named(graph, tmp_path):
    (node,) = graph.add("recorder", record=str(tmp_path / "set"), **QUICK)
    sender = graph.talk(BiotacAll, "/rh/tactile", reliable=False)
    graph.until(lambda: not accounts(node.status())["/rh/tactile"].reliable)
    message = biotac_all_to_msg({}, "rh", time.time_ns())

    def heard():
        sender.publish(message)
        time.sleep(0.05)
        return accounts(node.status())["/rh/tactile"].received > 3

    graph.until(heard)
    graph.until(lambda: node.status().sensor_states[0].startswith("e_th: all 24 values are 0") or heard())


def test_a_publisher_of_another_sensor_is_named(lone_graph, tmp_path):
    (node,) = lone_graph.add("recorder", record=str(tmp_path / "set"), **QUICK)
    lone_graph.start(
        "import rclpy, time; from std_msgs.msg import String; rclpy.init(); node = rclpy.create_node('other')\n"
        "sender = node.create_publisher(String, '/rh/tactile', 1)\nwhile True: time.sleep(1)"
    )
    line = "/rh/tactile: a publisher sends std_msgs/msg/String, not foretouch_msgs/msg/BiotacAll: nothing is received from it"
    lone_graph.until(lambda: node.reported().warnings == [line])


@pytest.mark.parametrize("name", ["hand", "camera"])
def test_an_empty_name_of_hand_or_camera_is_refused(name):
    with pytest.raises(ConfigError, match=rf"identity\.{name}: is empty; a dataset names the model of its {name}"):
        RecorderConfig.from_mapping({f"identity.{name}": " "})


def test_depth_images_are_recorded_with_their_infos_and_read_again(graph, tmp_path):
    pixels = np.full((48, 84), 700, np.uint16)
    plain = depth_builders.image(pixels, "16UC1")
    topic = "/camera/camera/depth/image_rect_raw"
    images = graph.probe.create_publisher(Image, topic, 10)
    infos = graph.probe.create_publisher(CameraInfo, "/camera/camera/depth/camera_info", 10)
    colour_topic, pixels_rgb = (
        "/camera/camera/color/image_raw",
        np.arange(48 * 84 * 3, dtype=np.uint32).astype(np.uint8),
    )
    colours = graph.probe.create_publisher(Image, colour_topic, 10)
    (node,) = graph.add("recorder", record=str(tmp_path / "set"), depth=topic, color=colour_topic, **QUICK)
    publishers = (images, infos, colours)
    graph.until(lambda: node.recording and all(each.get_subscription_count() for each in publishers))
    for k in range(5):
        header = header_to_msg("lens", 1_700_000_000_000_000_000 + k)
        infos.publish(CameraInfo(header=header, height=48, width=84, k=[61.0, 0, 41.5, 0, 61.0, 23.5, 0, 0, 1.0]))
        images.publish(Image(header=header, height=48, width=84, encoding="16UC1", step=plain.step, data=plain.data))
        colours.publish(
            Image(header=header, height=48, width=84, encoding="rgb8", step=84 * 3, data=pixels_rgb.tobytes())
        )
    graph.until(lambda: accounts(node.status())[topic].written == accounts(node.status())[colour_topic].written == 5)
    node.end()
    clouds = [item.cloud for item in open_source(tmp_path / "set", topic)]
    assert [cloud.stamp_ns % 10 for cloud in clouds] == list(range(5))
    expected = Cloud.from_depth(pixels, CameraModel(84, 48, 61.0, 61.0, 41.5, 23.5)).xyz
    for cloud in clouds:
        np.testing.assert_array_equal(cloud.xyz, expected)
        np.testing.assert_array_equal(cloud.rgb, pixels_rgb.reshape(48, 84, 3))
