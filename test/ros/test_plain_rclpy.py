# SPDX-License-Identifier: Apache-2.0
"""Only public rclpy is used, importing a node changes nothing of the process, and few frames lie before the model."""

import re
import subprocess
import sys
import traceback
from pathlib import Path

import pytest
from sensor_msgs.msg import PointCloud2

from foretouch.models.touch_model import TouchModel
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros
SOURCES = sorted(
    path
    for package in ("foretouch", "foretouch_lab")
    for path in (Path(__file__).parents[2] / "src" / package / "ros").rglob("*.py")
)
PRIVATE = re.compile(
    r"\b_rclpy|rclpy\.impl|ctypes|\._data\b|_parameter_overrides|_state_machine|_is_shutdown|setswitchinterval|mallopt|gc\.(un)?freeze"
)


def test_no_private_part_of_rclpy_and_no_change_of_the_interpreter():
    assert len(SOURCES) > 30
    found = [
        f"{path.name}:{n}: {line}"
        for path in SOURCES
        for n, line in enumerate(path.read_text().splitlines(), 1)
        if PRIVATE.search(line)
    ]
    assert found == []


def test_importing_the_nodes_sets_no_variable_and_leaves_shared_memory_alone():
    code = (
        "import os, sys, gc; before = dict(os.environ), gc.get_freeze_count(), sys.getswitchinterval();"
        "import foretouch.ros.nodes.perception, foretouch.ros.nodes.recorder;"
        "assert before == (dict(os.environ), gc.get_freeze_count(), sys.getswitchinterval())"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_from_the_callback_to_the_model_there_are_at_most_eight_frames(graph, scene_cloud, monkeypatch):
    """Of the adapted road, which has one more than that without a hand."""
    found, predict = [], TouchModel.predict

    def traced(model, *arguments, **options):
        found.append([frame.name for frame in traceback.extract_stack()])
        return predict(model, *arguments, **options)

    (node,) = graph.add("perception", model="contact-v3")
    assert node._touch.adapter is not None
    heard, publisher = graph.listen(TouchPredictionArray, "touch"), graph.talk_matched(PointCloud2, "points")
    graph.matched("touch")
    monkeypatch.setattr(TouchModel, "predict", traced)
    publisher.publish(cloud_to_msg(scene_cloud()))
    graph.until(lambda: heard)
    (frames,) = found
    road = frames[frames.index("_work") : -1]
    assert road[-1] == "predict"
    assert len(road) <= 8, road
