# SPDX-License-Identifier: Apache-2.0
"""`foretouch record` as a person calls it: a process of its own, over real DDS."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from foretouch.cli.record import record_panel
from foretouch.dataset.recording import verify_dataset
from foretouch_msgs.msg import RecorderStatus, TopicAccount

pytestmark = pytest.mark.ros


def record(*words: object) -> subprocess.Popen[str]:
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(76 + os.getpid() % 25),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    command = [sys.executable, "-m", "foretouch.cli.main", "record", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def test_ctrl_c_ends_the_recording_in_order(tmp_path: Path) -> None:
    process = record("-o", tmp_path / "set", "--object", "can", "--hand", "shadow:1", "--json")
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["recording"]
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    last = json.loads(out.splitlines()[-1])
    assert (last["recording"], last["reason"], last["samples"]) == (False, "", 0)
    assert last["sensors"] == {"TH": "no data", "MF": "no data", "camera": "no data"}
    (report,) = verify_dataset(tmp_path / "set")
    assert (report.finished, report.faults) == (True, [])

    process = record("-o", tmp_path / "set", "--hand", "shadow:2", "--seconds", 1)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "hand.serial: 1 there, 2 here" in err.splitlines()[-1]


def test_the_panel_tells_what_was_dropped_and_why_and_which_sensor_is_dead() -> None:
    from rich.console import Console

    status = RecorderStatus(
        recording=True,
        samples=12,
        last_sample="can/000012",
        outcomes=["no_tare", "recorded"],
        outcome_counts=[2, 12],
        sensors=["TH", "MF"],
        sensor_states=["alive", "frozen: the same 300 times"],
        pairing_error=0.012,
        pairing_error_max=0.034,
        disk_left=600.0,
        topics=[
            TopicAccount(topic="/rh/tactile", received=100, written=97, drop_reasons=["queue full"], drop_counts=[3]),
            TopicAccount(topic="/foretouch/grasps", lost=5),
            TopicAccount(topic="/foretouch/touch"),
        ],
    )
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(record_panel(status, "title"))
    text = console.export_text()
    for words in (
        "12 samples",
        "can/000012",
        "disk full in 10 min",
        "2 no tare",
        "12 recorded",
        "pairing error 12 ms, at most 34",
        "MF frozen: the same 300 times",
        "3 queue full",
        " grasps ",
    ):
        assert words in text
