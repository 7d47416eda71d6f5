# SPDX-License-Identifier: Apache-2.0
"""Grasps, predictions, markers, service and action in the frame of the robot, over DDS and handed over in one process."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from foretouch import reading
from foretouch.grasp.messages import decode_grasp, rotation_from_quaternion
from foretouch.models import load_model
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import GraspArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros

CAMERA = "camera_depth_optical_frame"
TURN = Rotation.from_euler("xyz", [-2.0, 0.3, 1.2])
SHIFT = np.array([0.45, -0.2, 0.8])
TO_BASE = FrameTransform("base_link", CAMERA, TURN.as_matrix(), SHIFT)
LINK = FrameTransform("camera_link", CAMERA, np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float), np.zeros(3))
TOLERANCE = 1e-6  # [m] and [rad]


@pytest.fixture
def in_robot(tmp_path):
    """Parameters of nodes that answer in the frame of the robot."""
    path = tmp_path / "hand_eye.yaml"
    path.write_text(f"translation: {SHIFT.tolist()}\nrotation: {TURN.as_quat().tolist()}\n")
    return {"output_frame": "base_link", "hand_eye": str(path)}


@pytest.fixture(scope="module")
def cloud(scene_cloud):
    return scene_cloud(n_objects=3, width=848)


@pytest.fixture(scope="module")
def truth(cloud):
    """The target, and its grasps in the frame of the camera."""
    target = Pipeline().segment(cloud).targets[0]
    return target, Pipeline().plan(target).grasps


def xyz_of(point):
    return np.array([point.x, point.y, point.z])


def in_base(points):
    return TURN.apply(points) + SHIFT


def check_grasp(message, grasp):
    """Compare with a grasp in the frame of the camera."""
    pairs = ((message.g1, grasp.g1), (message.g2, grasp.g2), (message.pose.position, (grasp.g1 + grasp.g2) / 2.0))
    for found, expected in pairs:
        assert np.linalg.norm(xyz_of(found) - in_base(expected)) <= TOLERANCE
    q = message.pose.orientation
    for found in (rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w])), message.rotation.reshape(3, 3)):
        apart = Rotation.from_matrix(found).inv() * TURN * Rotation.from_matrix(grasp.rotation)
        assert apart.magnitude() <= TOLERANCE


def answers(graph, cloud, model, **parameters):
    """The messages of `grasps`, `touch` and `markers` for one cloud."""
    graph.add(*PERCEPTION, model=model, **parameters)
    outputs = {"grasps": GraspArray, "touch": TouchPredictionArray, "markers": MarkerArray}
    heard = [graph.listen(kind, topic) for topic, kind in outputs.items()]
    camera = graph.talk(PointCloud2, "points")
    graph.matched("points", "object_cloud", "grasps", "touch")
    graph.matched("markers", publishers=2)
    camera.publish(cloud_to_msg(cloud))
    graph.until(lambda: heard[0] and heard[1])
    return heard


@pytest.mark.parametrize("direct", [True, False])
def test_a_grasp_in_the_frame_of_the_robot_is_the_truth(graph, cloud, truth, model_card, in_robot, direct):
    monitor = MonitorNode(with_clouds=True)
    graph.serve(monitor)
    grasps, touch, markers = answers(graph, cloud, model_card, **in_robot, direct=direct, grasp__method="original")
    target, _ = truth
    plan = Pipeline(PipelineConfig(grasp=graph.nodes[2].config.grasp)).plan(target).grasps[0]
    best, prediction = grasps[0].grasps[0], touch[0].predictions[0]
    assert (grasps[0].header.frame_id, grasps[0].status) == ("base_link", Status.OK)
    check_grasp(best, plan)
    assert touch[0].header.frame_id == prediction.header.frame_id == "base_link"
    assert (touch[0].header.stamp, prediction.grasp) == (grasps[0].header.stamp, best)
    (expected,) = load_model(model_card).predict(target.cloud, [plan])
    assert_allclose(reading(prediction)["PDC"][1], expected.value["PDC_MF"][0], rtol=1e-5)
    graph.until(lambda: any(one.ns == "contacts" for message in markers for one in message.markers))
    drawn = [one for message in markers for one in message.markers if one.ns in {"contacts", "thumb"}]
    assert {one.header.frame_id for one in drawn} == {"base_link"}
    balls = [one for one in drawn if one.type == Marker.SPHERE]
    for ball, contact in zip(balls, (plan.g1, plan.g2), strict=True):
        assert np.linalg.norm(xyz_of(ball.pose.position) - in_base(contact)) <= TOLERANCE
    graph.until(lambda: monitor.view().last is not None)
    assert monitor.view().answers == {"ok": 1}
    assert monitor.last_drawables() == []  # a prediction in another frame than its cloud is not drawn


def ask(graph, *arguments, **fields):
    return graph.call(PredictTouch, "predict_touch", PredictTouch.Request(*arguments, **fields)).touch


def test_requests_and_goals_from_either_frame_are_answered_in_that_of_the_robot(graph, truth, model_card, in_robot):
    (node,) = graph.add("touch_predictor", model=model_card, **in_robot)
    target, plan = truth
    cloud, table = objects_to_msg([target], CAMERA, 5), plane_to_msg(target.plane)
    grasps = [grasp_to_msg(one) for one in plan]
    there = ask(graph, cloud=cloud, grasps=grasps, table=[table])
    moved = [TO_BASE.grasp(one) for one in grasps]
    request = {"cloud": TO_BASE.cloud(cloud), "grasps": moved, "table": [TO_BASE.plane(table)]}
    here = ask(graph, **request)
    expected = load_model(model_card).predict(target.cloud, plan)
    for answer, tolerance in ((there, 1e-6), (here, 1e-4)):  # the points in base_link are rounded to float32
        assert (answer.header.frame_id, answer.status) == ("base_link", Status.OK), answer.reason
        for found, one, grasp in zip(answer.predictions, expected, plan, strict=True):
            check_grasp(found.grasp, grasp)
            assert_allclose(reading(found)["PDC"][0], one.value["PDC_TH"][0], rtol=tolerance)
    contents = [[(one.g1, one.g2, one.pose) for one in found] for found in (moved, [p.grasp for p in here.predictions])]
    assert contents[0] == contents[1]
    contacts = [value for one in moved for p in (one.g1, one.g2) for value in (p.x, p.y, p.z)]
    fields = {"cloud": request["cloud"], "contacts": contacts}
    arrays = PredictTouch.Request(**fields, rotations=np.concatenate([one.rotation for one in moved]))
    batch = graph.call(PredictTouch, "predict_touch", arrays).batch
    assert (batch.status, batch.reason, batch.header) == (Status.OK, "", here.header)
    assert_allclose(reading(batch)["PDC"], [reading(one)["PDC"] for one in here.predictions], rtol=1e-6)
    arrays = PredictTouch.Request(**fields, table=request["table"])
    computed = np.reshape(graph.call(PredictTouch, "predict_touch", arrays).batch.rotations, (-1, 3, 3))
    along = np.subtract(*np.moveaxis(np.reshape(contacts, (-1, 2, 3)), 1, 0))
    assert_allclose(computed[:, :, 2], along / np.linalg.norm(along, axis=1)[:, None], atol=1e-6)
    moved[0].rotation = np.zeros(9)
    for axis in "xyzw":
        setattr(moved[0].pose.orientation, axis, 0.0)
    posed = ask(graph, **request).predictions[0]
    (again,) = load_model(model_card).predict(target.cloud, [Pipeline().grasp_between(target, plan[0].g1, plan[0].g2)])
    assert_allclose(reading(posed)["PDC"][0], again.value["PDC_TH"][0], rtol=1e-3)

    goal = SampleGrasps.Goal(cloud=cloud, table=[table], count=5)
    _, result, feedback = graph.goal(SampleGrasps, "sample_grasps", goal)
    assert result.grasp_state == "success"
    assert {one.header.frame_id for one in (*result.grasp_candidates, *feedback[0].grasp_candidates)} == {"base_link"}
    for one in Pipeline(PipelineConfig(grasp=node.config.grasp.replace(count=5))).plan(target).grasps:
        check_grasp(min(result.grasps, key=lambda g: np.linalg.norm(xyz_of(g.g1) - in_base(one.g1))), one)
    for pose, grasp, prediction in zip(result.grasp_candidates, result.grasps, result.predictions, strict=True):
        assert pose.pose == grasp.pose == prediction.grasp.pose
    assert {one.id for one in feedback[0].grasps} == {one.id for one in result.grasps}


def test_objects_in_the_frame_of_a_link_are_refused_by_name(graph, truth, model_card):
    graph.add("grasp", "touch_predictor", model=model_card)
    target, plan = truth
    cloud, plane = LINK.cloud(objects_to_msg([target], CAMERA, 5)), LINK.plane(plane_to_msg(target.plane))
    answer = ask(graph, cloud=cloud, grasps=[LINK.grasp(grasp_to_msg(plan[0]))])
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


def test_a_header_alone_asks_about_the_latest_object(graph, cloud, truth, model_card, in_robot, tf2):
    header = {"cloud": PointCloud2(header=header_to_msg("base_link", 0))}
    (node,) = graph.add("touch_predictor", model=model_card, output_frame="base_link")
    target, plan = truth
    grasps = [grasp_to_msg(plan[0])]
    assert ask(graph, **header, grasps=grasps).status == Status.EMPTY_CLOUD
    answer = ask(graph, cloud=objects_to_msg([target], "base_link", 5), grasps=grasps)
    reason = "no_transform: the frame of the camera is not known before the first object_cloud"
    assert (answer.status, answer.reason) == (Status.UNKNOWN_FRAME, reason)
    graph.remove(node)
    grasps, touch, _ = answers(graph, cloud, model_card, **in_robot)
    request = {**header, "grasps": grasps[0].grasps}
    answer = ask(graph, **request)
    assert answer.header == touch[0].header
    assert_allclose(reading(answer.predictions[0])["PDC"][0], reading(touch[0].predictions[0])["PDC"][0], rtol=1e-6)
    check_grasp(answer.predictions[0].grasp, decode_grasp(TO_BASE.inverse().grasp(grasps[0].grasps[0])))
    request["cloud"].header.frame_id = "world"
    answer = ask(graph, **request)
    assert answer.status == Status.UNKNOWN_FRAME
    assert answer.reason == f"cloud: frame 'world' of the request is not '{CAMERA}' or 'base_link'"


def test_a_request_in_a_frame_that_nobody_knows_is_flagged_and_reported_and_refused_where_a_calibration_is_used(
    graph, truth, model_card, in_robot
):
    target, plan = truth
    grasps, table = [grasp_to_msg(one) for one in plan[:1]], TablePlane(plane=plane_to_msg(target.plane))
    tables, clouds = graph.talk(TablePlane, "table"), graph.talk(PointCloud2, "object_cloud")
    sent = graph.talk(GraspArray, "grasps")
    for parameters in ({}, in_robot):  # whose calibration names no frame of the camera
        (node,) = graph.add("touch_predictor", model=model_card, diagnostics_period_s=0.1, **parameters)
        graph.matched("table", "object_cloud", "grasps")
        own = objects_to_msg([target], CAMERA, 5)
        assert (
            ask(graph, cloud=objects_to_msg([target], "nowhere", 5), grasps=grasps).status == Status.OK
        )  # no cloud yet
        table.header = own.header
        for publisher, message in (
            (tables, table),
            (clouds, own),
            (sent, GraspArray(header=own.header, grasps=grasps)),
        ):
            publisher.publish(message)
            time.sleep(0.1)
        graph.until(lambda node=node: node._latest is not None)
        assert "unknown_frame" not in ask(graph, cloud=own, grasps=grasps).predictions[0].flags
        answer, reports = (
            ask(graph, cloud=objects_to_msg([target], "nowhere", 5), grasps=grasps),
            graph.reports("touch_predictor"),
        )
        if parameters:
            assert answer.status == Status.UNKNOWN_FRAME
            assert answer.reason == f"no_transform: hand_eye is for clouds in '{CAMERA}', not in 'nowhere'"
        else:
            assert (answer.status, "unknown_frame" in answer.predictions[0].flags) == (Status.OK, True)
            text = "a request is in frame 'nowhere', which is not that of the graph's clouds"
            graph.until(lambda text=text, reports=reports: reports and text in reports[-1].message)
        graph.remove(node)
