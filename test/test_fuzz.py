# SPDX-License-Identifier: Apache-2.0
"""The short form of `benchmarks/fuzz`: some changed files and some absurd messages of each kind."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from every_case import every_case

from benchmarks.fuzz import driver

ROOT = Path(__file__).parents[1]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("module", "cases"), [("files", 20), ("messages", 40)])
def test_nothing_changed_crashes_a_reader_is_used_in_silence_or_is_answered_with_what_is_not_finite(
    module: str, cases: int, tmp_path: Path
) -> None:
    if module == "messages":
        pytest.importorskip("rclpy", reason="ROS 2 is not installed")
        pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    kinds = import_module(f"benchmarks.fuzz.{module}").KINDS

    def check(name: str) -> None:
        (tmp_path / name).mkdir()
        case = kinds[name].prepare(tmp_path / name)
        for number in range(max(3, round(cases * kinds[name].weight))):
            outcome, detail, _ = driver.read_case(case, driver.generator(name, 0, number))
            assert outcome in ("read", "refused"), f"{number}: {detail}"

    every_case({name: name for name in kinds}, check)


def test_a_crash_by_a_signal_is_detected_named_and_followed_by_the_next_case() -> None:
    row, faults = driver.run("benchmarks.fuzz.driver", "crash", 10, 0)
    assert faults == [f"crash 0 {number}: signal: exit status -11" for number in (3, 7)]
    assert (row["read"], row["signal"]) == (8, 2)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(320)
def test_the_live_graph_answers_a_good_cloud_as_before() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    kinds = [word for kind in ("grasps", "executed_grasp", "predict_touch") for word in ("--kind", kind)]
    command = [sys.executable, "-m", "benchmarks.fuzz.live", "--batch", "15", "--cases", "45", *kinds]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
