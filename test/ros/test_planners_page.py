# SPDX-License-Identifier: Apache-2.0
"""What docs/planners.md states: its commands run, and it explains every status, flag and rule of costs."""

import itertools
import re
import time
from pathlib import Path

import pytest
import yaml
from sensor_msgs.msg import PointCloud2

from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.runtime.output_frame import read_hand_eye
from foretouch.ros.touch.config import COSTS, TouchPredictorConfig
from foretouch_msgs.msg import Status, TouchPrediction

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")
EXAMPLE = yaml.safe_load((ROOT / "examples" / "robot_frame.yaml").read_text(encoding="utf-8"))
PARAMETERS = EXAMPLE["/foretouch/touch_predictor"]["ros__parameters"]


def test_every_status_reference_flag_and_rule_is_explained():
    statuses = [name for name in dir(Status) if name.isupper() and isinstance(getattr(Status, name), int)]
    references = ["NONE", "TARE", "TOUCHES", "HISTORY"]
    assert all(hasattr(TouchPrediction, name) for name in references)
    flags = [
        "out_of_range",
        "unfamiliar",
        "similar_touches",
        "equal_pressure",
        "late",
        "reduced",
        "fallback_model",
        "ambiguous_target",
        "unknown_frame",
    ]
    missing = [name for name in (*statuses, *references, *flags, *COSTS) if f"`{name}`" not in PAGE]
    assert (len(statuses) > 15, missing) == (True, [])


def test_the_parameters_and_commands_of_the_page_are_those_of_the_node_and_those_tested_here():
    named = ("output_frame", "hand_eye", "transform_timeout_s", "sample_cost", "planner_action_type", "max_grasps")
    assert all(f"`{name}`" in PAGE and hasattr(TouchPredictorConfig(), name) for name in named)
    found = read_hand_eye(str(ROOT / PARAMETERS["hand_eye"]))
    assert found.target == TouchPredictorConfig(**PARAMETERS).output_frame == "base_link"
    lines = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
    assert sorted(" ".join(line.partition("#")[0].split()) for line in lines) == [
        "foretouch run --source config/scenes/clean.yaml",
        "foretouch run --source config/scenes/clean.yaml --params examples/robot_frame.yaml",
        "python examples/rank_grasps.py",
        "python examples/report_grasp.py",
        "python examples/sample_grasps.py",
    ]


@pytest.mark.slow
def test_the_example_planners_print_poses_in_the_frame_of_the_robot(lone_graph, scene_cloud, model_card):
    graph, published = lone_graph, itertools.count(1)
    publisher = graph.talk(PointCloud2, "points")
    graph.add(*PERCEPTION, model=model_card, **PARAMETERS | {"hand_eye": str(ROOT / PARAMETERS["hand_eye"])})
    graph.matched("points")

    def run(name):
        process = graph.start(f"import runpy; runpy.run_path({str(ROOT / 'examples' / name)!r}, run_name='__main__')")
        while process.poll() is None:
            publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=next(published))))
            time.sleep(0.3)
        printed, logged = process.communicate()
        assert process.returncode == 0, logged
        return printed

    text = run("rank_grasps.py")
    assert re.match(r"(4\d|50) of 50 grasps predicted; the gentlest is \d+:", text), text
    assert ("PDC thumb" in text, "nan" in text) == (True, False)
    assert re.search(r"^g1 = \(.*\) m in base_link$", text, re.MULTILINE)
    sampled = run("sample_grasps.py")
    assert re.match(r"\d+ of 10 grasps, in base_link, cheapest first:\ncost -?\d\.\d\d at ", sampled)
