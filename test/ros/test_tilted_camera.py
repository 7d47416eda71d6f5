# SPDX-License-Identifier: Apache-2.0
"""What a tilted camera sees is recorded with its table, and a model that is fitted to it knows its own objects."""

from dataclasses import replace

import numpy as np
import pytest
from robot_builders import QUICK, RecordedRobot
from sensor_msgs.msg import PointCloud2
from sim_builders import CAN, scene

import foretouch as ft
from foretouch.cloud.messages import decode_plane
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.types import stamp_ns
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_msgs.msg import GraspArray, TablePlane

pytestmark = [pytest.mark.ros, pytest.mark.slow]

GRASPS, NEW = 20, 24
BOX = {"name": "box", "shape": "box", "size_m": [0.06, 0.08, 0.1], "pose": {"rest": "upright"}}


class TiltedRobot(RecordedRobot):
    """A camera of a scene beside the graph, whose best grasp the hand executes."""

    def __init__(self, graph, node, maker):
        self.maker, self.points = maker, graph.talk_matched(PointCloud2, "points")
        self.planned, self.tables = graph.listen(GraspArray, "grasps"), graph.listen(TablePlane, "table")
        super().__init__(graph, node)

    def see(self, _name):
        """The grasp is executed on what was seen when it was planned."""

    def record(self, _name, number):
        self.now += 1_000_000
        self.points.publish(cloud_to_msg(self.maker.frame(number).cloud(stamp_ns=self.now)))
        self.graph.until(lambda: self.planned and stamp_ns(self.planned[-1].header.stamp) == self.now)
        super().record(self.planned[-1].grasps[0].id, number)


def unfamiliar(model, frames):
    """The share of images of a camera in which the best grasp is flagged."""
    pipeline, flagged = Pipeline(), 0
    for frame in frames:
        (target,) = pipeline.segment(frame.cloud()).targets
        (flags,) = model.predict(target, pipeline.plan(target).grasps[:1]).flags
        flagged += "unfamiliar" in flags
    return flagged / len(frames)


def test_a_model_fitted_to_what_a_tilted_camera_recorded_knows_its_own_objects(graph, tmp_path):
    maker = FrameMaker(scene(CAN, BOX, camera={"width": 424, "height": 320, "tilt_deg": 40.0}))
    path = tmp_path / "grasps"
    (recorder,) = graph.add("recorder", record=str(path), folder=str(tmp_path), object="thing", **QUICK)
    graph.add("perception")
    robot = TiltedRobot(graph, recorder, maker)
    for number in range(GRASPS):
        robot.record("", number)
    graph.remove(*graph.nodes)

    seen = {stamp_ns(message.header.stamp): decode_plane(message.plane) for message in robot.tables}
    samples = list(ft.open(path))
    assert len(samples) == GRASPS
    for sample in samples:
        np.testing.assert_array_equal(sample.table.coefficients, seen[sample.cloud.stamp_ns].coefficients)
    frames = [maker.frame(1000 + number) for number in range(NEW)]
    shares = [
        unfamiliar(ft.fit(chosen), frames) for chosen in (samples, [replace(sample, table=None) for sample in samples])
    ]
    assert shares[0] <= 0.25
    assert shares[1] >= shares[0] + 0.2, "samples without a table would do as well"
