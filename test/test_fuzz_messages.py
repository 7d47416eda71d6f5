# SPDX-License-Identifier: Apache-2.0
"""The short form of `benchmarks/fuzz/messages.py` and `live.py`: some absurd messages of each kind."""

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")

FOLDER = Path(__file__).parents[1] / "benchmarks" / "fuzz"
CASES = 40


def script(name: str) -> Any:
    """One of the scripts as a module."""
    sys.path.insert(0, str(FOLDER))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(FOLDER))


FUZZ = script("messages")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", FUZZ.KINDS)
def test_no_absurd_message_raises_or_is_answered_with_what_is_not_finite(name: str) -> None:
    kind, index = FUZZ.KINDS[name](), list(FUZZ.KINDS).index(name)
    for number in range(max(3, round(CASES * kind.weight))):
        outcome, detail, _ = FUZZ.read_case(kind, 0, number, index)
        assert outcome in ("read", "refused"), f"{name} 0 {number}: {detail}"


@pytest.mark.ros
def test_the_live_graph_answers_a_good_cloud_as_before() -> None:
    kinds = [word for kind in ("grasps", "executed_grasp", "predict_touch") for word in ("--kind", kind)]
    command = [sys.executable, str(FOLDER / "live.py"), "--batch", "15", "--cases", "45", *kinds]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
