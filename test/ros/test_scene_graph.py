# SPDX-License-Identifier: Apache-2.0
"""A scene that the camera node publishes, the graph plans grasps on, and the simulated hand executes."""

import json
import time

import numpy as np
import pytest

pytest.importorskip("libusb_package", reason="the camera's libraries are not installed")

from sensor_msgs.msg import PointCloud2
from sim_builders import CAN, SHORT, scene

from foretouch.camera.config import ScheduleConfig
from foretouch.cloud.messages import decode_cloud
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_msgs.msg import ExecutedGrasp, GraspArray

pytestmark = pytest.mark.ros


def write(folder, config):
    (folder / "scene.yaml").write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    return str(folder / "scene.yaml")


def test_the_hand_holds_what_the_camera_saw(graph, tmp_path):
    config = scene(CAN, camera={"width": 424, "height": 320})
    show = ScheduleConfig(path=write(tmp_path, config), dwell_s=1.5, origin_ns=time.time_ns())
    shown = {"scene__path": show.path, "scene__dwell_s": show.dwell_s, "scene__origin_ns": show.origin_ns}
    points, grasps = graph.listen(PointCloud2, "points", reliable=False), graph.listen(GraspArray, "grasps")
    reports = graph.listen(ExecutedGrasp, "executed_grasp")
    graph.add("segmentation", "grasp")
    graph.add("hand", **shown, **SHORT)
    graph.add("camera", source="scene", camera__fps=5, **shown)
    graph.until(lambda: len(reports) >= 2, timeout_s=40.0)
    assert all(report.success for report in reports)
    assert {report.grasp_id for report in reports} <= {grasp.id for message in grasps for grasp in message.grasps}
    for cloud in map(decode_cloud, points[:3]):
        expected = FrameMaker(config).frame(show.slot(cloud.stamp_ns)).cloud()
        np.testing.assert_allclose(cloud.xyz, expected.xyz, atol=1e-6)
