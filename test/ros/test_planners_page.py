# SPDX-License-Identifier: Apache-2.0
"""What docs/planners.md states: its commands run, and it explains every status, flag and rule of costs."""

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import yaml
from sensor_msgs.msg import PointCloud2

from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.runtime.hand_eye import read_hand_eye
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.costs import COSTS
from foretouch_msgs.msg import Status, TouchPrediction

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")


def test_every_status_reference_flag_and_rule_is_explained() -> None:
    statuses = [name for name in dir(Status) if name.isupper() and isinstance(getattr(Status, name), int)]
    references = ["NONE", "TARE", "TOUCHES", "HISTORY"]
    assert all(hasattr(TouchPrediction, name) for name in references)
    flags = ["out_of_range", "unfamiliar", "late", "reduced", "fallback_model", "ambiguous_target"]
    missing = [name for name in (*statuses, *references, *flags, *COSTS) if f"`{name}`" not in PAGE]
    assert len(statuses) > 15
    assert missing == []


def test_the_parameters_of_the_page_and_of_its_files_are_those_of_the_node() -> None:
    settings = TouchPredictorConfig()
    named = ("output_frame", "hand_eye", "transform_timeout_s", "sample_cost", "planner_action_type", "max_grasps")
    assert all(f"`{name}`" in PAGE and hasattr(settings, name) for name in named)
    example = yaml.safe_load((ROOT / "examples" / "robot_frame.yaml").read_text(encoding="utf-8"))
    (parameters,) = (group["ros__parameters"] for group in example.values())
    found = read_hand_eye(str(ROOT / parameters["hand_eye"]))
    assert found.target == TouchPredictorConfig(**parameters).output_frame == "base_link"


def test_the_commands_of_the_page_are_those_that_are_tested_here() -> None:
    commands = [
        line.partition("#")[0].split()
        for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
        for line in block.splitlines()
    ]
    assert sorted(map(tuple, commands)) == [
        ("foretouch", "run", "--source", "config/scenes/clean.yaml"),
        ("foretouch", "run", "--source", "config/scenes/clean.yaml", "--params", "examples/robot_frame.yaml"),
        ("python", "examples/rank_grasps.py"),
        ("python", "examples/sample_grasps.py"),
    ]


@pytest.mark.slow
def test_the_example_planners_print_poses_in_the_frame_of_the_robot(graph, scene_cloud, model_card) -> None:
    example = yaml.safe_load((ROOT / "examples" / "robot_frame.yaml").read_text(encoding="utf-8"))
    parameters = example["/foretouch/touch_predictor"]["ros__parameters"]
    graph.add(*PERCEPTION, **{**parameters, "model": model_card, "hand_eye": str(ROOT / parameters["hand_eye"])})
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    done = threading.Event()

    def camera() -> None:
        for stamp in range(1, 1000):
            publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=stamp)))
            if done.wait(0.3):
                return

    thread = threading.Thread(target=camera)
    thread.start()
    printed = []
    try:
        for name in ("rank_grasps.py", "sample_grasps.py"):
            result = subprocess.run(
                [sys.executable, ROOT / "examples" / name],
                env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
            assert result.returncode == 0, result.stderr
            printed.append(result.stdout)
    finally:
        done.set()
        thread.join()
    assert re.search(r"^g1 = \(.*\) m in base_link$", printed[0], re.MULTILINE)
    assert re.match(r"\d+ of 10 grasps, in base_link, cheapest first:\ncost -?\d\.\d\d at ", printed[1])
