# SPDX-License-Identifier: Apache-2.0
"""The recorder node while things break around it: cables, clocks, the disk, and the process itself."""

import shutil

import pytest
from pair_builders import REST
from robot_builders import MS, outcomes, start

from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.ros.messages.conversions import stamp_to_msg
from foretouch_msgs.msg import Status
from foretouch_msgs.srv import StartRecording

pytestmark = pytest.mark.ros


def sensors(status):
    return dict(zip(status.sensors, status.sensor_states, strict=True))


def recorded(path):
    """The records of a dataset without faults."""
    assert [report.fault_lines() for report in verify_dataset(path)] == [[]]
    return list(RecordedDataset(path))


def begin(graph, path):
    return graph.call(StartRecording, "start_recording", StartRecording.Request(path=str(path)))


@pytest.mark.slow
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


def test_a_removed_folder_is_named_in_one_of_the_next_reports_and_its_loss_counted(graph, tmp_path, capfd):
    node, robot, statuses = start(graph, tmp_path / "set")
    for number in range(2):
        robot.record(f"g-{number}", number)
    shutil.rmtree(tmp_path / "set")
    before = len(statuses)
    graph.until(lambda: statuses and "was removed during the recording" in statuses[-1].reason)
    assert statuses[-1].status == Status.FAILED
    assert len(statuses) <= before + 3  # which come each second
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
