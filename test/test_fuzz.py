# SPDX-License-Identifier: Apache-2.0
"""The short form of `benchmarks/fuzz`: some changed files and some absurd messages of each kind."""

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from every_case import every_case

from benchmarks.fuzz import driver

ROOT = Path(__file__).parents[1]


def read_all(kinds: Mapping[str, driver.Kind], folder: Path, cases: int) -> None:
    def check(name: str) -> None:
        (folder / name).mkdir()
        case = kinds[name].prepare(folder / name)
        for number in range(max(3, round(cases * kinds[name].weight))):
            outcome, detail, _ = driver.read_case(case, driver.generator(kinds, name, 0, number))
            assert outcome in ("read", "refused"), f"{number}: {detail}"

    every_case({name: name for name in kinds}, check)


@pytest.mark.filterwarnings("ignore")
def test_no_changed_file_crashes_a_reader_or_is_used_in_silence(tmp_path: Path) -> None:
    from benchmarks.fuzz.files import KINDS

    read_all(KINDS, tmp_path, 30)


@pytest.mark.filterwarnings("ignore")
def test_no_file_that_is_consistent_and_wrong_hangs_raises_or_has_another_overwritten(tmp_path: Path) -> None:
    from structural_fuzz import KINDS

    read_all(KINDS, tmp_path, 12)


@pytest.mark.filterwarnings("ignore")
def test_no_absurd_message_raises_or_is_answered_with_what_is_not_finite(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    from benchmarks.fuzz.messages import KINDS

    read_all(KINDS, tmp_path, 40)


def test_a_crash_by_a_signal_is_detected_named_and_followed_by_the_next_case(tmp_path: Path) -> None:
    row, faults = driver.run("benchmarks.fuzz.driver", "crash", 10, 0, tmp_path)
    assert faults == [f"crash 0 {number}: signal: exit status -11" for number in (3, 7)]
    assert (row["read"], row["signal"]) == (8, 2)
    assert {path.name for path in tmp_path.iterdir()} == {"crash-0-3", "crash-0-7"}


@pytest.mark.ros
@pytest.mark.slow
def test_the_live_graph_answers_a_good_cloud_as_before() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    kinds = [word for kind in ("grasps", "executed_grasp", "predict_touch") for word in ("--kind", kind)]
    command = [sys.executable, "-m", "benchmarks.fuzz.live", "--batch", "15", "--cases", "45", *kinds]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
