# SPDX-License-Identifier: Apache-2.0
"""Frames of requests over DDS: that of a link is refused, one that the graph does not know is flagged, a header stands for the latest cloud."""

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sensor_msgs.msg import PointCloud2

from foretouch import reading
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg
from foretouch.types import Plane
from foretouch_msgs.msg import Grasp, GraspArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros

CAMERA = "camera_depth_optical_frame"
TO_LINK = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)  # from the optical frame to that of the camera's link


@pytest.fixture(scope="module")
def truth(scene_cloud):
    """The target, and its grasps in the frame of the camera."""
    target = Pipeline().segment(scene_cloud(n_objects=3, width=848)).targets[0]
    return target, Pipeline().plan(target).grasps


def ask(graph, **fields):
    return graph.call(PredictTouch, "predict_touch", PredictTouch.Request(**fields)).touch


def test_objects_in_the_frame_of_a_link_are_refused_by_name(graph, truth, model_card):
    graph.add("grasp", "touch_predictor", model=model_card)
    target, plan = truth
    turned = replace(target.cloud, xyz=np.ascontiguousarray(target.cloud.xyz @ TO_LINK.T.astype(np.float32)))
    cloud = objects_to_msg([replace(target, cloud=turned)], "camera_link", 5)
    plane = plane_to_msg(Plane.from_coefficients([*(TO_LINK @ target.plane.normal), target.plane.offset]))
    answer = ask(graph, cloud=cloud, grasps=[grasp_to_msg(plan[0])])
    assert "in view along x, as in the frame of a link" in answer.reason
    heard = [graph.listen(GraspArray, "grasps"), graph.listen(TouchPredictionArray, "touch")]
    clouds, tables = graph.talk(PointCloud2, "object_cloud"), graph.talk(TablePlane, "table")
    graph.matched("object_cloud", "table", "grasps", "touch")
    tables.publish(TablePlane(header=header_to_msg("camera_link", 5), plane=plane))
    clouds.publish(cloud)
    graph.until(lambda: heard[0] and heard[1])
    for message in (answer, *heard[0], *heard[1]):
        assert message.status == Status.UNKNOWN_FRAME
        assert message.reason.startswith("cloud: frame 'camera_link': not_optical: ")


def test_a_header_stands_for_the_latest_object_and_a_frame_that_nobody_knows_is_flagged_or_refused(
    graph, truth, model_card
):
    target, plan = truth
    grasps, table = [grasp_to_msg(one) for one in plan[:1]], TablePlane(plane=plane_to_msg(target.plane))
    tables, clouds = graph.talk(TablePlane, "table"), graph.talk(PointCloud2, "object_cloud")
    sent = graph.talk(GraspArray, "grasps")
    (node,) = graph.add("touch_predictor", model=model_card, diagnostics_period_s=0.1)
    graph.matched("table", "object_cloud", "grasps")
    latest = PointCloud2(header=header_to_msg(CAMERA, 0))
    assert ask(graph, cloud=latest, grasps=grasps).status == Status.EMPTY_CLOUD
    own, elsewhere = (objects_to_msg([target], frame, 5) for frame in (CAMERA, "nowhere"))
    assert ask(graph, cloud=elsewhere, grasps=grasps).status == Status.OK  # no cloud yet
    table.header = own.header
    for publisher, message in ((tables, table), (clouds, own), (sent, GraspArray(header=own.header, grasps=grasps))):
        publisher.publish(message)
        time.sleep(0.1)
    graph.until(lambda: node._step.latest is not None)
    expected, answer = ask(graph, cloud=own, grasps=grasps), ask(graph, cloud=latest, grasps=grasps)
    assert "unknown_frame" not in expected.predictions[0].flags
    assert answer.header == own.header
    assert_allclose(
        reading(answer.predictions[0])["PDC"].value, reading(expected.predictions[0])["PDC"].value, rtol=1e-6
    )
    (typed,) = ask(graph, grasps=[Grasp(g1=grasps[0].g1, g2=grasps[0].g2)]).predictions  # without a header, w = 1
    assert (typed.status, typed.header) == (Status.OK, own.header)
    expected_turn = hand_rotation(plan[0].g1, plan[0].g2, object_axis(target.cloud, target.plane, GeoGraspConfig())[0])
    assert_allclose(typed.grasp.rotation, expected_turn.ravel(), atol=1e-12)
    latest.header.frame_id = "world"
    answer = ask(graph, cloud=latest, grasps=grasps)
    assert answer.status == Status.UNKNOWN_FRAME
    assert answer.reason == f"cloud: frame 'world' is not the cloud's, '{CAMERA}'"
    answer = ask(graph, cloud=elsewhere, grasps=grasps)
    assert (answer.status, "unknown_frame" in answer.predictions[0].flags) == (Status.OK, True)
