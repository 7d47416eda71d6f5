# SPDX-License-Identifier: Apache-2.0
"""Readings that are shown beside a prediction are those that the recorder would have recorded."""

import threading

import numpy as np
import pytest
from pair_builders import REST, level
from robot_builders import QUICK, Robot
from sensor_msgs.msg import Image, PointCloud2

from benchmarks.random_scenes import random_scene
from foretouch import plan, segment
from foretouch.dataset.labelling.assembler import AssemblerConfig
from foretouch.dataset.labelling.cut import PairingConfig
from foretouch.ros.messages.clouds import cloud_to_msg, colours_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.ros.nodes.monitor import MonitorNode, View
from foretouch.tactile.messages.table import TactileConfig
from foretouch_msgs.msg import BiotacAll, GraspArray, Status, TouchPrediction, TouchPredictionArray

pytestmark = pytest.mark.ros


class PredictedRobot(Robot):
    """Every planned grasp is also predicted."""

    def __init__(self, graph):
        self.answers = graph.talk(TouchPredictionArray, "touch")
        for kind, topic in ((BiotacAll, "/rh/tactile"), (GraspArray, "grasps")):
            graph.listen(kind, topic)
        graph.matched("touch")
        super().__init__(graph)

    def see(self, name):
        publish, self.grasps.publish = self.grasps.publish, self._predict
        super().see(name)
        self.grasps.publish = publish

    def _predict(self, message):
        one = [TouchPrediction(header=message.header, grasp=grasp, status=Status.OK) for grasp in message.grasps]
        self.answers.publish(TouchPredictionArray(header=message.header, predictions=one))


def test_readings_of_a_successful_grasp_are_shown_and_others_are_not(graph, monkeypatch):
    pairing = {name.removeprefix("pairing__"): value for name, value in QUICK.items()}
    config = AssemblerConfig(successes_only=True, pairing=PairingConfig(**pairing))
    monkeypatch.setattr("foretouch.ros.nodes.monitor.AssemblerConfig", lambda **_: config)
    monitor = MonitorNode(hand=TactileConfig())
    graph.serve(monitor)
    robot = PredictedRobot(graph)
    times = robot.grasp("good", 1)
    graph.until(lambda: monitor.view().executed is not None)
    prediction, readings = monitor.view().executed
    assert prediction.grasp.id == "good"
    np.testing.assert_allclose(readings.touch.values, level(1), atol=5.0)
    np.testing.assert_allclose(readings.tare.values, REST, atol=5.0)

    robot.report("good too", times)  # overlaps: the recorder rejects it
    robot.report("failed", robot.grasp("failed", 2, tell=False), success=False)
    graph.until(lambda: robot.feel(REST, 1) or monitor._assembler.results.total() == 3)
    assert dict(monitor._assembler.results) == {"recorded": 1, "overlap": 1, "grasp_failed": 1}
    assert monitor.view().executed[0].grasp.id == "good"


def test_a_drawn_scene_has_the_colours_of_its_stamp(graph):
    monitor = MonitorNode(with_clouds=True)
    graph.serve(monitor)
    frame = random_scene(np.random.default_rng(4), 160, 120, 2).render()
    header = header_to_msg("camera", 5_000_000_000)
    found = segment(frame.cloud("camera", 5_000_000_000))
    points, objects, colours = (
        graph.talk_matched(kind, topic)
        for kind, topic in ((PointCloud2, "points"), (PointCloud2, "object_cloud"), (Image, "color/image"))
    )
    answers = graph.talk_matched(TouchPredictionArray, "touch")
    points.publish(cloud_to_msg(found.cloud))
    objects.publish(objects_to_msg(found.targets, "camera", 5_000_000_000))
    colours.publish(colours_to_msg(header_to_msg("camera", 4_000_000_000), 0 * frame.rgb))
    colours.publish(colours_to_msg(header, frame.rgb))
    graph.until(lambda: len(monitor._colours) == 2 and monitor._objects and monitor._scenes)
    (grasp,) = plan(found.targets[0], count=1)
    prediction = TouchPrediction(header=header, grasp=grasp_to_msg(grasp), status=Status.OK)
    prediction.grasp.object_id = found.targets[0].id
    answers.publish(TouchPredictionArray(header=header, predictions=[prediction]))
    graph.until(monitor.last_drawables)
    ((scene, target, _, _),) = monitor.last_drawables()
    np.testing.assert_array_equal(scene.rgb, frame.rgb)
    assert target.id == found.targets[0].id


def test_of_executed_grasps_those_after_a_touch_are_drawn():
    monitor = MonitorNode.__new__(MonitorNode)
    monitor._lock, monitor._drawable = threading.Lock(), []
    monitor._executed = {(True, True): "new after", (False, False): "known", (True, False): "new before"}
    assert monitor.last_drawables() == ["known", "new after"]


def test_reasons_are_counted_by_kind_however_many_numbers_they_hold():
    monitor = MonitorNode.__new__(MonitorNode)
    monitor._lock, monitor._view, monitor._closed, monitor._count = threading.Lock(), View(), False, None
    monitor._on_touch = None
    for k in range(1000):
        reason = f"no object: the nearest is {k / 7:.3f} m away of {k} points"
        monitor._receive_touch(TouchPredictionArray(status=Status.NO_OBJECT, reason=reason))
    for k in range(1000):
        word = "".join(chr(97 + int(digit)) for digit in str(k))
        monitor._receive_touch(TouchPredictionArray(status=Status.NO_OBJECT, reason=word))
    reasons = monitor.view().reasons
    kind = "no object: the nearest is # m away of # points"
    assert reasons[kind] == 1000
    assert monitor.view().last_reasons[kind] == reason
    assert len(reasons) <= 101
    assert reasons.total() == 2000
