# SPDX-License-Identifier: Apache-2.0
"""The recorder node while things break around it: cables, clocks, the disk, and the process itself."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from pair_builders import REST, level
from rclpy.qos import ReliabilityPolicy
from recording_builders import fail_writes
from robot_builders import FRAME, MS, QUICK, Robot, accounts, start

from foretouch.dataset.recording import SAMPLE_TOPIC, RecordedDataset, repair_dataset, verify_dataset
from foretouch.errors import FileError
from foretouch.ros.messages.conversions import stamp_to_msg
from foretouch.ros.messages.tactile import biotac_all_to_msg
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, RecorderStatus, Status
from foretouch_msgs.srv import StartRecording

pytestmark = pytest.mark.ros


def sensors(status: Any) -> dict[str, str]:
    return dict(zip(status.sensors, status.sensor_states, strict=True))


def outcomes(status: Any) -> dict[str, int]:
    return dict(zip(status.outcomes, status.outcome_counts, strict=True))


def recorded(path: Path) -> list[Any]:
    with RecordedDataset(path) as dataset:
        return [dataset[k].record for k in range(len(dataset))]


def test_a_pulled_cable_is_told_by_name_and_the_recording_goes_on_when_it_is_back(graph: Any, tmp_path: Path) -> None:
    node, robot, _ = start(graph, tmp_path / "set", pairing__wait_s=0.5)
    robot.grasp("before", 0)
    graph.until(lambda: node.status().samples == 1)
    assert set(sensors(node.status()).values()) == {"alive"}

    graph.until(lambda: sensors(node.status())["TH"] == sensors(node.status())["MF"] == "no data")
    assert sensors(node.status())["camera"] == "alive"  # it is given longer
    robot.now += 100 * MS  # its stamps run ahead of the clock
    robot.see("numb")  # a grasp while the hand tells nothing
    times = {name: stamp_to_msg(robot.now + k * 100 * MS) for k, name in enumerate(("start", "contact", "release"), 1)}
    robot.told.publish(ExecutedGrasp(grasp_id="numb", success=True, **times))
    graph.until(lambda: outcomes(node.status()) == {"recorded": 1, "no_tactile": 1})

    robot.now += 1000 * MS
    graph.until(lambda: robot.feel(REST, 1) or sensors(node.status())["camera"] == "no data")
    assert sensors(node.status()) == {"TH": "alive", "MF": "alive", "camera": "no data"}
    times = {
        name: stamp_to_msg(robot.now - (4 - k) * 50 * MS) for k, name in enumerate(("start", "contact", "release"))
    }
    robot.told.publish(ExecutedGrasp(grasp_id="blind", success=True, **times))  # nobody has seen it planned
    graph.until(lambda: outcomes(node.status()) == {"recorded": 1, "no_tactile": 1, "grasp_unknown": 1})

    robot.grasp("after", 1)
    graph.until(lambda: node.status().samples == 2)
    assert set(sensors(node.status()).values()) == {"alive"}
    assert (node.recording, node.status().reason) == (True, "")
    node.end()
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "set")] == [[]]
    assert [one.sample.grasp.id for one in recorded(tmp_path / "set") if one.sample.touch] == ["before", "after"]


def test_a_clock_set_back_and_stamps_that_repeat_make_no_wrong_pair(graph: Any, tmp_path: Path) -> None:
    node, robot, _ = start(graph, tmp_path / "set", pairing__wait_s=0.5, pairing__clock_s=60.0)
    robot.grasp("before", 0)
    graph.until(lambda: node.status().samples == 1)
    ended = robot.now
    robot.now -= 20_000 * MS  # the sensor's clock is set back; what is felt now is stamped before that grasp
    robot.feel(level(3), 60)
    graph.until(lambda: node.session_status().anomalies["clock_jump"] == 1)
    for _ in range(5):  # a driver that repeats a message with its stamp
        robot.feel(REST, 1)
        robot.now -= 10 * MS
    graph.until(lambda: node.session_status().anomalies["duplicate_stamp"] == 4)
    robot.now = ended + 1000 * MS  # the clock is right again
    robot.grasp("after", 1)
    graph.until(lambda: sum(outcomes(node.status()).values()) == 2)
    node.end()
    assert outcomes(node.status()) == {"recorded": 2}
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "set")] == [[]]
    for record in recorded(tmp_path / "set"):
        number = {"before": 0, "after": 1}[record.sample.grasp.id]
        np.testing.assert_allclose(record.sample.touch.vector(), level(number), atol=5.0)
    assert node.status().received == node.status().used == sum(robot.sent.values())


@pytest.mark.parametrize("code", [errno.EIO, errno.EROFS])
def test_a_disk_that_fails_ends_the_recording_and_says_why(
    graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    node, robot, told = start(graph, tmp_path / "set")
    robot.grasp("g-0", 0)
    graph.until(lambda: node.status().samples == 1)
    fail_writes(monkeypatch, 1, code)  # what follows are the last counts, for which there is room
    robot.feel(REST, 30)
    graph.until(lambda: not node.in_session)
    monkeypatch.undo()
    assert f"{os.strerror(code)} (errno {code}): the session has ended, its 1 samples are in the file" in node.reason
    graph.until(lambda: told and told[-1].reason == node.reason)
    graph.until(lambda: node.status().received == sum(robot.sent.values()))
    for topic in node.status().topics:
        assert topic.received == topic.written + sum(topic.drop_counts)
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "set")] == [[]]
    assert len(recorded(tmp_path / "set")) == 1
    assert node.begin(str(tmp_path / "set")) == tmp_path / "set"  # the disk is back
    assert node.status().reason == ""


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(graph: Any, tmp_path: Path) -> None:
    (node,) = graph.add("recorder", folder=str(tmp_path), **QUICK)
    (tmp_path / "file").write_bytes(b"")
    answer = graph.call(StartRecording, "start_recording", StartRecording.Request(path="file/set"))
    assert not answer.success
    assert re.fullmatch(rf"{tmp_path}/file/set: Not a directory \(errno 20\)", answer.message)
    assert not node.recording
    with pytest.raises(FileError, match="File name too long"):
        node.begin("x" * 5000)
    with pytest.raises(FileError, match=r"\(errno \d+\)"):
        node.begin("/proc/set")  # a file system that takes no folders
    assert graph.call(StartRecording, "start_recording", StartRecording.Request(path="set")).success


def test_kill_9_of_the_process_loses_nothing_that_was_told(graph: Any, tmp_path: Path) -> None:
    told = graph.listen(RecorderStatus, "recorder_status")
    arguments = {"record": tmp_path / "set", "object": "can", **QUICK, "writing.accounts_s": 0.5}
    words = [word for name, value in arguments.items() for word in ("-p", f"{name.replace('__', '.')}:={value}")]
    code = "import sys; from foretouch.ros.executables import recorder; sys.exit(recorder())"
    command = [sys.executable, "-c", code, "--ros-args", *words]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(graph.domain)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            robot = Robot(graph)
            for number in range(4):
                robot.grasp(f"g-{number}", number)
                if number < 3:
                    graph.until(lambda number=number: told and told[-1].samples == number + 1)
            last = told[-1]  # the fourth is on its way
        finally:
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
    assert last.last_sample in {record.sample.id for record in records}
    for number, record in enumerate(records):
        assert record.sample.grasp.id == f"g-{number}"
        np.testing.assert_allclose(record.sample.touch.vector(), level(number), atol=5.0)
    assert report.messages[SAMPLE_TOPIC] == len(records)
    for topic in last.topics:  # messages too: what was told to be written is written
        assert report.messages[topic.topic] >= topic.written


def test_an_override_of_qos_takes_effect_and_outlives_what_publishers_offer(graph: Any, tmp_path: Path) -> None:
    wish = "qos_overrides./rh/tactile.subscription"
    (node,) = graph.add(
        "recorder", record=str(tmp_path / "set"), **{f"{wish}.depth": 7, f"{wish}.reliability": "best_effort"}, **QUICK
    )
    profiles = {
        name: node.get_subscriptions_info_by_topic(name)[0].qos_profile
        for name in ("/rh/tactile", "/foretouch/object_cloud")
    }
    assert profiles["/rh/tactile"].reliability == ReliabilityPolicy.BEST_EFFORT
    assert profiles["/foretouch/object_cloud"].reliability == ReliabilityPolicy.RELIABLE
    assert node.get_parameter(f"{wish}.depth").value == 7
    assert node.unknown_parameters() == set()
    sender = graph.talk(BiotacAll, "/rh/tactile", reliable=True)
    graph.matched("/rh/tactile")
    time.sleep(1.1)  # two looks at what is offered
    sender.publish(biotac_all_to_msg({}, FRAME, time.time_ns()))
    graph.until(lambda: accounts(node.status())["/rh/tactile"].received == 1)
    assert not accounts(node.status())["/rh/tactile"].reliable


def test_an_input_that_must_be_reliable_tells_of_a_publisher_that_is_not(graph: Any, tmp_path: Path) -> None:
    (node,) = graph.add("recorder", **{"qos_overrides./rh/tactile.subscription.reliability": "reliable"}, **QUICK)
    graph.talk(BiotacAll, "/rh/tactile", reliable=False)
    graph.until(lambda: node._mismatches)
    assert list(node._mismatches.values()) == [
        "/rh/tactile: a publisher has incompatible QoS (RELIABILITY): no message passes"
    ]
    assert accounts(node.status())["/rh/tactile"].reliable


def test_an_override_that_names_no_policy_is_refused_and_leaves_no_subscription(graph: Any) -> None:
    (node,) = graph.add("recorder", **{"qos_overrides./foretouch/grasps.subscription.reliability": "sometimes"})
    assert node.state_name == "unconfigured"
    assert [one.topic_name for one in node.subscriptions if one.topic_name.startswith(("/rh", "/foretouch"))] == []
    assert not node.autostart()


def removed_during_a_recording(graph: Any, path: Path, **parameters: Any) -> tuple[Any, Robot, float]:
    """Record two samples, remove the folder, and wait until the status names it; gives the time that took [s]."""
    node, robot, told = start(graph, path, **parameters)
    for number in range(2):
        robot.grasp(f"g-{number}", number)
        graph.until(lambda number=number: node.status().samples == number + 1)
    shutil.rmtree(path)
    began = time.monotonic()
    graph.until(lambda: told and "was removed during the recording" in told[-1].reason)
    took_s = time.monotonic() - began
    assert told[-1].status == Status.FAILED
    graph.until(lambda: not node.in_session)
    return node, robot, took_s


def test_a_removed_folder_is_named_within_a_second_and_its_loss_counted(
    graph: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    node, robot, took_s = removed_during_a_recording(graph, tmp_path / "set")
    assert took_s < 1.0
    messages = sum(robot.sent.values())
    file = re.escape(str(tmp_path / "set" / "session-0001.mcap"))
    lost = rf"{file}: was removed during the recording: 2 samples and {messages} messages are lost"
    assert re.fullmatch(rf"{lost}: no fallback_folder is set", node.reason)
    status = node.status()
    assert (status.samples, status.used, status.received) == (0, 0, messages)
    assert dict(zip(status.drop_reasons, status.drop_counts, strict=True)) == {"file removed": messages}
    assert not (tmp_path / "set").exists()
    assert "Traceback" not in "".join(capfd.readouterr())
    answer = graph.call(StartRecording, "start_recording", StartRecording.Request(path=str(tmp_path / "set")))
    assert answer.success


def test_a_removed_folder_is_written_to_the_fallback_folder(graph: Any, tmp_path: Path) -> None:
    fallback = tmp_path / "other" / "disk"
    (fallback / "set").mkdir(parents=True)  # the name is taken
    node, robot, _ = removed_during_a_recording(graph, tmp_path / "set", fallback_folder=str(fallback))
    file = tmp_path / "set" / "session-0001.mcap"
    kept = fallback / "set-2"
    assert node.reason == (f"{file}: was removed during the recording: the session was written to {kept}, 2 samples")
    assert node.path == str(kept)
    assert [report.fault_lines() for report in verify_dataset(kept)] == [[]]
    for number, record in enumerate(one for one in recorded(kept) if one.sample.touch):
        assert record.sample.grasp.id == f"g-{number}"
        np.testing.assert_allclose(record.sample.touch.vector(), level(number), atol=5.0)
    status = node.status()
    assert status.samples == 2
    assert status.received == status.used == sum(robot.sent.values())
    (report,) = verify_dataset(kept)
    assert sum(count for topic, count in report.messages.items() if topic != SAMPLE_TOPIC) == status.used


def test_a_fallback_folder_that_cannot_be_written_is_named(graph: Any, tmp_path: Path) -> None:
    node, _, _ = removed_during_a_recording(graph, tmp_path / "set", fallback_folder="/proc/none")
    assert "2 samples and" in node.reason
    assert re.search(r"messages are lost: /proc/none: .* \(errno \d+\)$", node.reason)


def test_a_folder_that_was_moved_keeps_its_samples(graph: Any, tmp_path: Path) -> None:
    node, robot, _ = start(graph, tmp_path / "set")
    robot.grasp("g-0", 0)
    graph.until(lambda: node.status().samples == 1)
    (tmp_path / "set").rename(tmp_path / "moved")
    graph.until(lambda: not node.in_session)
    file = tmp_path / "set" / "session-0001.mcap"
    assert node.reason == (
        f"{file}: was moved or unmounted during the recording, with its 1 samples: the session has ended"
    )
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "moved")] == [[]]
    assert len(recorded(tmp_path / "moved")) == 1


def test_bytes_that_are_no_message_are_counted_and_the_recording_goes_on(graph: Any, tmp_path: Path) -> None:
    node, robot, _ = start(graph, tmp_path / "set")
    robot.grasp("before", 0)
    graph.until(lambda: node.status().samples == 1)
    for publisher, topic in ((robot.hand, "/rh/tactile"), (robot.grasps, "grasps"), (robot.told, "executed_grasp")):
        publisher.publish(b"\0\1\0\0" + b"\xff" * 60)
        graph.until(lambda topic=topic: any(name.endswith(topic) for name in unreadable(node)))
    robot.grasp("after", 1)
    graph.until(lambda: node.status().samples == 2)
    assert (node.recording, node.status().reason) == (True, "")
    node.end()
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "set")] == [[]]


def unreadable(node: Any) -> list[str]:
    return [name.removeprefix("unreadable ") for name in node.session_status().anomalies if "unreadable" in name]
