# SPDX-License-Identifier: Apache-2.0
"""The recorder node while things break around it: cables, clocks, the disk, and the process itself."""

import shutil
import signal
import time

import numpy as np
import pytest
from pair_builders import REST, level
from rclpy.qos import ReliabilityPolicy
from robot_builders import FRAME, MS, QUICK, Robot, accounts, outcomes, start

from foretouch.dataset.recording.reader import RecordedDataset
from foretouch.dataset.recording.repair import repair_dataset
from foretouch.dataset.recording.sample_codec import SAMPLE_TOPIC
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.ros.messages.conversions import stamp_to_msg
from foretouch_lab.ros.hand_messages import biotac_all_to_msg
from foretouch_msgs.msg import BiotacAll, RecorderStatus, Status
from foretouch_msgs.srv import StartRecording

pytestmark = pytest.mark.ros


def sensors(status):
    return dict(zip(status.sensors, status.sensor_states, strict=True))


def recorded(path):
    """The records of a dataset without faults."""
    assert [report.fault_lines() for report in verify_dataset(path)] == [[]]
    dataset = RecordedDataset(path)
    return [dataset[k].sample for k in range(len(dataset))]


def assert_levels(records):
    """Each sample has the touch of its grasp, which is named `g-<number>`."""
    for record in records:
        number = int(record.grasp.id.removeprefix("g-"))
        np.testing.assert_allclose(record.touch.values, level(number), atol=5.0)


def begin(graph, path):
    return graph.call(StartRecording, "start_recording", StartRecording.Request(path=str(path)))


def test_a_pulled_cable_is_named_and_the_recording_continues_when_it_is_back(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set", pairing__wait_s=0.5)
    robot.record("before", 0)
    assert set(sensors(node.status()).values()) == {"alive"}

    graph.until(lambda: sensors(node.status())["TH"] == sensors(node.status())["MF"] == "no data")
    assert sensors(node.status())["camera"] == "alive"  # it is given longer
    robot.now += 100 * MS  # its stamps run ahead of the clock
    robot.see("numb")  # a grasp while the hand sends nothing
    times = {name: stamp_to_msg(robot.now + k * 100 * MS) for k, name in enumerate(("start", "contact", "release"), 1)}
    robot.report("numb", times)
    graph.until(lambda: outcomes(node.status()) == {"recorded": 1, "no_tactile": 1})

    robot.now += 1000 * MS
    graph.until(lambda: robot.feel(REST, 1) or sensors(node.status())["camera"] == "no data")
    assert sensors(node.status()) == {"TH": "alive", "MF": "alive", "camera": "no data"}
    times = {name: stamp_to_msg(robot.now - k * 50 * MS) for name, k in (("start", 4), ("contact", 3), ("release", 2))}
    robot.report("blind", times)  # nobody has seen it planned
    graph.until(lambda: outcomes(node.status()) == {"recorded": 1, "no_tactile": 1, "grasp_unknown": 1})

    robot.record("after", 1)
    assert set(sensors(node.status()).values()) == {"alive"}
    assert (node.recording, node.status().reason) == (True, "")
    node.end()
    assert [one.grasp.id for one in recorded(tmp_path / "set") if one.touch] == ["before", "after"]


@pytest.mark.slow
def test_kill_9_of_the_process_loses_nothing_that_was_reported(lone_graph, tmp_path):
    graph = lone_graph
    statuses = graph.listen(RecorderStatus, "recorder_status")
    arguments = {"record": tmp_path / "set", "object": "can", **QUICK}
    words = [word for name, value in arguments.items() for word in ("-p", f"{name.replace('__', '.')}:={value}")]
    process, robot = graph.start("recorder", *words), Robot(graph)
    for number in range(4):
        robot.grasp(f"g-{number}", number)
        if number < 3:
            graph.until(lambda number=number: statuses and statuses[-1].samples == number + 1)
    last = statuses[-1]  # the fourth is on its way
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=10)
    assert process.returncode == -signal.SIGKILL
    assert last.samples >= 3
    assert not verify_dataset(tmp_path / "set")[0].finished
    repair_dataset(tmp_path / "set")
    (report,) = verify_dataset(tmp_path / "set")
    assert report.clean
    records = recorded(tmp_path / "set")
    assert len(records) >= last.samples
    assert last.last_sample in {record.id for record in records}
    assert [record.grasp.id for record in records] == [f"g-{number}" for number in range(len(records))]
    assert_levels(records)
    assert report.messages[SAMPLE_TOPIC] == len(records)
    for topic in last.topics:  # messages too: what was reported as written is written
        assert report.messages[topic.topic] >= topic.written


def test_an_override_of_qos_takes_effect_outlives_what_publishers_offer_and_may_be_refused(graph, tmp_path):
    wish, tactile = "qos_overrides./rh/tactile.subscription", lambda: accounts(node.status())["/rh/tactile"]
    overrides = {f"{wish}.depth": 7, f"{wish}.reliability": "best_effort"}
    (node,) = graph.add("recorder", record=str(tmp_path / "set"), **overrides, **QUICK)
    found = [node.get_subscriptions_info_by_topic(name)[0] for name in ("/rh/tactile", "/foretouch/object_cloud")]
    wanted = [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE]
    assert [info.qos_profile.reliability for info in found] == wanted
    assert node.get_parameter(f"{wish}.depth").value == 7
    sender = graph.talk_matched(BiotacAll, "/rh/tactile")
    time.sleep(1.1)  # two looks at what is offered
    sender.publish(biotac_all_to_msg({}, FRAME, time.time_ns()))
    graph.until(lambda: tactile().received == 1)
    assert not tactile().reliable
    graph.remove(node)
    (node,) = graph.add("recorder", **{"qos_overrides./foretouch/grasps.subscription.reliability": "sometimes"})
    assert (node.state_name, node.autostart()) == ("unconfigured", False)
    assert not [
        subscription for subscription in node.subscriptions if subscription.topic_name.startswith(("/rh", "/foretouch"))
    ]


def test_a_removed_folder_is_named_within_a_second_and_its_loss_counted(graph, tmp_path, capfd):
    node, robot, statuses = start(graph, tmp_path / "set")
    for number in range(2):
        robot.record(f"g-{number}", number)
    shutil.rmtree(tmp_path / "set")
    began = time.monotonic()
    graph.until(lambda: statuses and "was removed during the recording" in statuses[-1].reason)
    assert (statuses[-1].status, time.monotonic() - began < 1.0) == (Status.FAILED, True)
    graph.until(lambda: node.reason)
    messages, file = sum(robot.sent.values()), tmp_path / "set" / "session-0001.mcap"
    assert node.reason == f"{file}: was removed during the recording: 2 samples and {messages} messages are lost"
    status = node.status()
    assert (status.samples, status.used, status.received) == (0, 0, messages)
    assert dict(zip(status.drop_reasons, status.drop_counts, strict=True)) == {"file removed": messages}
    assert not (tmp_path / "set").exists()
    assert "Traceback" not in "".join(capfd.readouterr())
    assert begin(graph, tmp_path / "set").success


def test_bytes_that_are_no_message_are_counted_and_the_recording_continues(graph, tmp_path):
    node, robot, _ = start(graph, tmp_path / "set")
    robot.record("before", 0)
    topics = {"/rh/tactile": robot.hand, "/foretouch/grasps": robot.grasps, "/foretouch/executed_grasp": robot.told}
    for topic, publisher in topics.items():
        publisher.publish(b"\0\1\0\0" + b"\xff" * 60)
        graph.until(lambda topic=topic: f"unreadable {topic}" in node.session_status().anomalies)
    robot.record("after", 1)
    assert (node.recording, node.status().reason) == (True, "")
    node.end()
    recorded(tmp_path / "set")
