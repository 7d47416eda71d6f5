# SPDX-License-Identifier: Apache-2.0
"""`foretouch record` as a person calls it: a process of its own, over real DDS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

from foretouch.dataset.recording import verify_dataset

pytestmark = [pytest.mark.ros, pytest.mark.slow]
pytest.importorskip("rclpy", reason="ROS 2 is not installed")


def record(environment: dict[str, str], *words: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "foretouch.cli.main", "record", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def test_ctrl_c_ends_the_recording_in_order(tmp_path, environment) -> None:
    process = record(environment, "-o", tmp_path / "set", "--object", "can", "--hand", "shadow:1", "--json")
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

    process = record(environment, "-o", tmp_path / "set", "--hand", "shadow:2", "--seconds", 1)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "hand.serial: 1 there, 2 here" in err.splitlines()[-1]
