# SPDX-License-Identifier: Apache-2.0
"""A scene that the camera node publishes, the graph plans grasps on, and the simulated hand executes."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("libusb_package", reason="the camera's libraries are not installed")

from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from sim_builders import CAN, scene

from foretouch.dataset.messages import decode_cloud
from foretouch.errors import ConfigError
from foretouch.ros.nodes.camera import CameraNodeConfig
from foretouch.simulation.message_faults import FaultConfig
from foretouch.simulation.scene_camera import FrameMaker
from foretouch.simulation.schedule import ScheduleConfig
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import ExecutedGrasp, GraspArray

pytestmark = pytest.mark.ros

SHORT = {"course__rest_s": 0.2, "course__approach_s": 0.1, "course__close_s": 0.1, "course__hold_s": 0.2}


def test_the_hand_holds_what_the_camera_saw(graph, tmp_path) -> None:
    config = scene(CAN, camera={"width": 424, "height": 320})
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    show = ScheduleConfig(path=str(path), dwell_s=1.5, origin_ns=time.time_ns())
    shown = {"scene__path": show.path, "scene__dwell_s": show.dwell_s, "scene__origin_ns": show.origin_ns}
    points, grasps = graph.listen(PointCloud2, "points", reliable=False), graph.listen(GraspArray, "grasps")
    told = graph.listen(ExecutedGrasp, "executed_grasp")
    graph.add("segmentation", "grasp")
    graph.add("hand", **shown, **SHORT)
    graph.add("camera", source="scene", camera__fps=5, **shown)
    graph.until(lambda: len(told) >= 2, timeout_s=40.0)

    assert all(report.success for report in told)
    assert {report.grasp_id for report in told} <= {one.id for message in grasps for one in message.grasps}
    for message in points[:3]:
        cloud = decode_cloud(message)
        expected = FrameMaker(config).frame(show.slot(cloud.stamp_ns)).cloud()
        np.testing.assert_allclose(cloud.xyz, expected.xyz, atol=1e-6)


def test_faults_are_for_the_camera_of_a_scene() -> None:
    with pytest.raises(ConfigError, match="faults: are supported by the camera of a scene only, not device"):
        CameraNodeConfig(faults=FaultConfig(drop_share=0.1))
    assert CameraNodeConfig(source="scene", faults=FaultConfig(drop_share=0.1)).faults.drop_share == 0.1


def test_faults_of_a_running_camera_can_be_changed(graph, tmp_path) -> None:
    config = scene(CAN, camera={"width": 96, "height": 72})
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    points = graph.listen(PointCloud2, "points", reliable=False)
    (camera,) = graph.add("camera", source="scene", camera__fps=15, scene__path=str(path))
    graph.until(lambda: points)
    assert camera.set_parameters([Parameter("faults.skew_s", value=3600.0)])[0].successful
    graph.until(lambda: stamp_ns(points[-1].header.stamp) > time.time_ns() + 3500 * 10**9, timeout_s=10.0)
