# SPDX-License-Identifier: Apache-2.0
"""Readings that are shown beside a prediction are those that the recorder would have recorded."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from pair_builders import REST, level
from robot_builders import FRAME, MS, Robot
from sensor_msgs.msg import PointCloud2

from foretouch.dataset.pairing import Interval, PairingConfig, TouchBuffer, TouchReading, cut_touch
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.tactile.messages import TactileConfig, make_reader
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import (
    BiotacAll,
    ExecutedGrasp,
    Grasp,
    GraspArray,
    Status,
    TouchPrediction,
    TouchPredictionArray,
)

pytestmark = pytest.mark.ros


class PredictedRobot(Robot):
    """Every planned grasp is also predicted."""

    def __init__(self, graph: Any) -> None:
        self.answers = graph.talk(TouchPredictionArray, "touch")
        self.heard = graph.listen(BiotacAll, "/rh/tactile")
        graph.listen(GraspArray, "grasps")
        graph.matched("touch")
        super().__init__(graph)

    def see(self, name: str) -> None:
        publish, self.grasps.publish = self.grasps.publish, self._predict
        super().see(name)
        self.grasps.publish = publish

    def _predict(self, message: GraspArray) -> None:
        one = [TouchPrediction(header=message.header, grasp=grasp, status=Status.OK) for grasp in message.grasps]
        self.answers.publish(TouchPredictionArray(header=message.header, predictions=one))

    def hold(self, name: str, number: int) -> dict[str, Any]:
        """A grasp with margins as long as the default settings demand."""
        self.see(name)
        self.now += MS
        self.feel(REST, 80)
        times = {"start": header_to_msg(FRAME, self.now).stamp}
        self.feel(REST, 20)
        times["contact"] = header_to_msg(FRAME, self.now).stamp
        self.feel(level(number), 40)
        times["release"] = header_to_msg(FRAME, self.now).stamp
        self.feel(REST, 20)
        return times

    def report(self, name: str, times: dict[str, Any], *, success: bool = True) -> None:
        self.told.publish(ExecutedGrasp(header=header_to_msg(FRAME, self.now), grasp_id=name, success=success, **times))


@pytest.fixture
def monitor(graph: Any, monkeypatch: pytest.MonkeyPatch) -> MonitorNode:
    from foretouch.dataset.pairing import AssemblerConfig

    # The robot of the tests is in a hurry: its stamps run ahead of the clock.
    config = AssemblerConfig(successes_only=True, pairing=PairingConfig(clock_s=10.0, wait_s=0.5))
    monkeypatch.setattr("foretouch.ros.nodes.monitor.AssemblerConfig", lambda **_: config)
    node = MonitorNode(with_hand=True)
    graph._executor.add_node(node)
    graph.nodes.append(node)
    return node


def test_readings_of_a_successful_grasp_are_shown_and_others_are_not(graph: Any, monitor: MonitorNode) -> None:
    robot = PredictedRobot(graph)
    times = robot.hold("good", 1)
    robot.report("good", times)
    graph.until(lambda: monitor.view().executed is not None)
    prediction, readings = monitor.view().executed
    assert prediction.grasp.id == "good"
    buffer, reader = TouchBuffer(), make_reader(TactileConfig())
    graph.until(lambda: len(robot.heard) == robot.sent["/rh/tactile"])
    for message in robot.heard:
        one = reader.read(message)
        buffer.add(TouchReading(one.stamp_ns, one.counts, one.others, one.stamp_ns))
    cut = cut_touch(buffer, Interval(**{name: stamp_ns(time) for name, time in times.items()}), PairingConfig())
    np.testing.assert_array_equal(readings.touch.vector(), cut.touch.vector())
    np.testing.assert_array_equal(readings.tare.vector(), cut.tare.vector())

    robot.report("good too", times)  # overlaps: the recorder rejects it
    failed = robot.hold("failed", 2)
    robot.report("failed", failed, success=False)
    graph.until(lambda: robot.feel(REST, 1) or monitor._assembler.results.total() == 3)
    assert dict(monitor._assembler.results) == {"recorded": 1, "overlap": 1, "grasp_failed": 1}
    assert monitor.view().executed[0].grasp.id == "good"


def test_the_last_answers_on_known_and_on_unfamiliar_objects_can_be_drawn(graph: Any, scene_cloud: Any) -> None:
    node = MonitorNode(with_clouds=True)
    graph._executor.add_node(node)
    graph.nodes.append(node)
    assert node.last_drawables() == []
    answers, clouds = graph.talk(TouchPredictionArray, "touch"), graph.talk(PointCloud2, "object_cloud")
    graph.matched("touch")
    graph.matched("object_cloud")
    for k, flags in enumerate((["unfamiliar"], [], ["unfamiliar"], ["late"])):
        cloud = scene_cloud(stamp_ns=(k + 1) * 10**9)
        scene = Pipeline().segment(cloud)
        message = objects_to_msg(scene.targets, cloud.frame_id, cloud.stamp_ns)
        clouds.publish(message)
        grasp = Grasp(id=str(k), object_id=scene.targets[0].id)
        one = TouchPrediction(header=message.header, grasp=grasp, status=Status.OK, flags=flags)
        answers.publish(TouchPredictionArray(header=message.header, predictions=[one]))
    graph.until(lambda: [one.prediction.grasp.id for one in node.last_drawables()] == ["3", "2"])
