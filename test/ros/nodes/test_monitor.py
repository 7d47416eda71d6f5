# SPDX-License-Identifier: Apache-2.0
"""Readings that are shown beside a prediction are those that the recorder would have recorded."""

import numpy as np
import pytest
from pair_builders import REST, level
from robot_builders import FRAME, MS, Robot
from sensor_msgs.msg import PointCloud2

from foretouch.dataset.pairing import AssemblerConfig, Interval, PairingConfig, TouchBuffer, TouchReading, cut_touch
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

    def __init__(self, graph):
        self.answers = graph.talk(TouchPredictionArray, "touch")
        self.heard = graph.listen(BiotacAll, "/rh/tactile")
        graph.listen(GraspArray, "grasps")
        graph.matched("touch")
        super().__init__(graph)

    def see(self, name):
        publish, self.grasps.publish = self.grasps.publish, self._predict
        super().see(name)
        self.grasps.publish = publish

    def _predict(self, message):
        one = [TouchPrediction(header=message.header, grasp=grasp, status=Status.OK) for grasp in message.grasps]
        self.answers.publish(TouchPredictionArray(header=message.header, predictions=one))

    def hold(self, name, number):
        """A grasp with margins as long as the default settings demand."""
        self.see(name)
        self.now += MS
        self.feel(REST, 80)
        times = {}
        for key, counts, readings in (("start", REST, 20), ("contact", level(number), 40), ("release", REST, 20)):
            times[key] = header_to_msg(FRAME, self.now).stamp
            self.feel(counts, readings)
        return times

    def report(self, name, times, *, success=True):
        self.told.publish(ExecutedGrasp(header=header_to_msg(FRAME, self.now), grasp_id=name, success=success, **times))


def test_readings_of_a_successful_grasp_are_shown_and_others_are_not(graph, monkeypatch):
    # The stamps of the robot run ahead of the clock.
    config = AssemblerConfig(successes_only=True, pairing=PairingConfig(clock_s=10.0, wait_s=0.5))
    monkeypatch.setattr("foretouch.ros.nodes.monitor.AssemblerConfig", lambda **_: config)
    monitor = MonitorNode(with_hand=True)
    graph.serve(monitor)
    robot = PredictedRobot(graph)
    times = robot.hold("good", 1)
    robot.report("good", times)
    graph.until(lambda: monitor.view().executed is not None)
    prediction, readings = monitor.view().executed
    assert prediction.grasp.id == "good"
    buffer, reader = TouchBuffer(), make_reader(TactileConfig())
    graph.until(lambda: len(robot.heard) == robot.sent["/rh/tactile"])
    for one in map(reader.read, robot.heard):
        buffer.add(TouchReading(one.stamp_ns, one.counts, one.others, one.stamp_ns))
    cut = cut_touch(buffer, Interval(**{name: stamp_ns(time) for name, time in times.items()}), PairingConfig())
    np.testing.assert_array_equal(readings.touch.vector(), cut.touch.vector())
    np.testing.assert_array_equal(readings.tare.vector(), cut.tare.vector())

    robot.report("good too", times)  # overlaps: the recorder rejects it
    robot.report("failed", robot.hold("failed", 2), success=False)
    graph.until(lambda: robot.feel(REST, 1) or monitor._assembler.results.total() == 3)
    assert dict(monitor._assembler.results) == {"recorded": 1, "overlap": 1, "grasp_failed": 1}
    assert monitor.view().executed[0].grasp.id == "good"


def test_the_last_answers_on_known_and_on_unfamiliar_objects_can_be_drawn(graph, scene_cloud):
    node = MonitorNode(with_clouds=True)
    graph.serve(node)
    assert node.last_drawables() == []
    answers, clouds = graph.talk(TouchPredictionArray, "touch"), graph.talk(PointCloud2, "object_cloud")
    graph.matched("touch", "object_cloud")
    cloud = scene_cloud()
    targets = Pipeline().segment(cloud).targets
    for k, flags in enumerate((["unfamiliar"], [], ["unfamiliar"], ["late"])):
        message = objects_to_msg(targets, cloud.frame_id, (k + 1) * 10**9)
        clouds.publish(message)
        grasp = Grasp(id=str(k), object_id=targets[0].id)
        one = TouchPrediction(header=message.header, grasp=grasp, status=Status.OK, flags=flags)
        answers.publish(TouchPredictionArray(header=message.header, predictions=[one]))
    graph.until(lambda: [one.prediction.grasp.id for one in node.last_drawables()] == ["3", "2"])
