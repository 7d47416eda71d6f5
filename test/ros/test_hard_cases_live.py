# SPDX-License-Identifier: Apache-2.0
"""The hard cases through running nodes over real DDS: each gets an answer or a refusal with a name, and no NaN.

One graph gets all cases; after them a good cloud and a good request must be answered as before, bit for bit.
"""

import re

import numpy as np
import pytest
from corpus.clouds import across, bar, object_cases, scene_cases
from every_case import every_case
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg, point_to_msg
from foretouch.ros.messages.requests import status_name
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.types import Cloud, stamp_ns
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import GraspArray, ObjectArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(600)]

OUTPUTS = {"objects": ObjectArray, "table": TablePlane, "grasps": GraspArray, "touch": TouchPredictionArray,
           "markers": MarkerArray}  # fmt: skip
OBJECTS = {case.name: case for case in object_cases() if case.cloud.size <= 200_000}
SCENES = {case.name: case for case in scene_cases() if case.cloud.size <= 200_000}
REQUESTED = {"table 1e9 m away": "farther away than 1000 m", "grasp zero rotation": "ok"}  # nine zeros: it is computed


def content(one):
    """All numbers of a prediction to their last bit, without stamps."""
    contacts = [value for p in (one.grasp.g1, one.grasp.g2) for value in (p.x, p.y, p.z)]
    return np.array([*one.scalars, *one.values, *one.lower, *one.upper, *contacts, *one.grasp.rotation]).tobytes()


def agree(answer, pattern=""):
    """An answer without NaN, or a refusal with a name and a reason of the pattern; "ok" demands an answer, "" leaves it open."""
    for prediction in answer.predictions:
        assert (
            np.isfinite([*prediction.scalars, *prediction.values]).all()
            if prediction.status == Status.OK
            else prediction.reason
        )
    told = status_name(answer.status), answer.reason
    if answer.status in (Status.OK, Status.INITIAL_POINTS):
        assert pattern in ("", "ok"), told
        return
    assert bool(answer.reason) > (pattern == "ok" or answer.status == Status.FAILED or "status" in told[0]), told
    assert re.search(pattern, answer.reason), told


class Life:
    """A running graph, all that it publishes, and what it answers to a good cloud and a good request."""

    def __init__(self, graph):
        self.graph, self.last_ns = graph, 1_700_000_000_000_000_000
        graph.add("perception", grasp_hold=0.0, silence_s=1e6, late_after_s=0.0)
        self.heard = {topic: graph.listen(kind, topic) for topic, kind in OUTPUTS.items()}
        self.points = graph.talk(PointCloud2, "points")
        graph.matched("points", *OUTPUTS)
        self.good = self.answer_good()

    def send(self, cloud):
        """Publish a cloud; the answer on `touch`."""
        message, self.last_ns = cloud_to_msg(cloud), self.last_ns + 1_000_000
        message.header = header_to_msg("camera", self.last_ns)
        self.points.publish(message)
        touch = self.heard["touch"]
        self.graph.until(lambda: touch and stamp_ns(touch[-1].header.stamp) == self.last_ns, 20.0)
        return touch[-1]

    def ask(self, cloud, grasps, plane):
        table = [] if plane is None else [plane_to_msg(plane)]
        request = PredictTouch.Request(cloud=cloud_to_msg(Cloud(cloud.xyz)), grasps=grasps, table=table)
        request.cloud.header.frame_id = "camera"
        return self.graph.call(PredictTouch, "predict_touch", request).touch

    def answer_good(self):
        box = Cloud((bar() + np.array([0.02, -0.01, 1.2])).astype(np.float32))
        answered, asked = self.send(warm_up_cloud()), self.ask(box, [grasp_to_msg(across())], None)
        assert answered.predictions[0].status == asked.predictions[0].status == Status.OK
        return [content(one.predictions[0]) for one in (answered, asked)]

    def check(self):
        """No message holds NaN, there was no internal error, and the good ones are answered as before."""
        assert self.answer_good() == self.good
        for node in self.graph.nodes:
            assert (node.internal_errors.counts(), node.state_name) == ({}, "active")
        for topic in ("objects", "table", "grasps", "markers"):
            for message in self.heard[topic]:
                assert not re.search(r"(?<!score=)\b(nan|inf)\b", str(message))
            self.heard[topic].clear()


@pytest.fixture(scope="module")
def life(module_graph):
    return Life(module_graph)


def test_scenes_on_the_topic(life):
    def check(case):
        touch = life.send(Cloud(case.cloud.xyz))
        if case.segmented != "ok":
            assert status_name(touch.status) == case.segmented
        agree(touch, "ok" if case.segmented == "ok" else case.reason)
        assert bool(touch.predictions) == (case.segmented == "ok")

    every_case(SCENES, check)
    life.check()


def test_objects_on_the_topic_and_in_requests_with_and_without_orientation(life):
    def check(case):
        agree(life.send(Cloud(case.cloud.xyz)))
        grasps = []
        for rotation in (case.grasp.rotation.reshape(9), np.zeros(9)):  # one that is no rotation has no quaternion
            message = GraspMsg(g1=point_to_msg(case.grasp.g1), g2=point_to_msg(case.grasp.g2), rotation=rotation)
            message.pose.orientation.w = 0.0
            grasps.append(message)
        answer = life.ask(case.cloud, grasps, case.plane)
        expected = "ok" if case.predicted == "ok" else f"{case.predicted}|holds no finite point"
        if case.predicted == "not a rotation matrix":
            expected = "not a rotation|no orientation"  # of a message, where nine zeros are none
        for prediction, pattern in zip(
            answer.predictions or [answer], (REQUESTED.get(case.name, expected), ""), strict=False
        ):
            found = TouchPredictionArray(status=prediction.status, reason=prediction.reason)
            agree(found, pattern)

    every_case(OBJECTS, check)
    life.check()
