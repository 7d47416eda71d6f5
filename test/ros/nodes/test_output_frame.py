# SPDX-License-Identifier: Apache-2.0
"""Grasps, predictions, markers, service and action in the frame of the robot, over DDS and handed over in one process."""

import sys

import numpy as np
import pytest
import tf2_stand_in
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from foretouch.dataset.messages import rotation_from_quaternion
from foretouch.errors import ForetouchError
from foretouch.models import load_model
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros

CAMERA = "camera_depth_optical_frame"
TURN = Rotation.from_euler("xyz", [-2.0, 0.3, 1.2])
SHIFT = np.array([0.45, -0.2, 0.8])
TO_BASE = FrameTransform("base_link", CAMERA, TURN.as_matrix(), SHIFT)
TOLERANCE = 1e-6  # [m] and [rad]


@pytest.fixture
def hand_eye(tmp_path) -> str:
    path = tmp_path / "hand_eye.yaml"
    path.write_text(f"translation: {SHIFT.tolist()}\nrotation: {TURN.as_quat().tolist()}\n")
    return str(path)


@pytest.fixture(scope="module")
def cloud(scene_cloud):
    return scene_cloud(n_objects=3, width=848)


@pytest.fixture(scope="module")
def truth(cloud):
    """The target, and its best grasp in the frame of the camera."""
    target = Pipeline().segment(cloud).targets[0]
    return target, Pipeline(PipelineConfig()).plan(target).grasps


def xyz_of(point) -> np.ndarray:
    return np.array([point.x, point.y, point.z])


def in_base(points: np.ndarray) -> np.ndarray:
    return TURN.apply(points) + SHIFT


def check_grasp(message: Grasp, g1: np.ndarray, g2: np.ndarray, rotation: np.ndarray) -> None:
    """Compare with contacts and rotation in the frame of the camera."""
    assert np.linalg.norm(xyz_of(message.g1) - in_base(g1)) <= TOLERANCE
    assert np.linalg.norm(xyz_of(message.g2) - in_base(g2)) <= TOLERANCE
    assert np.linalg.norm(xyz_of(message.pose.position) - in_base((g1 + g2) / 2.0)) <= TOLERANCE
    q = message.pose.orientation
    posed = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
    for found in (posed, message.rotation.reshape(3, 3)):
        apart = Rotation.from_matrix(found).inv() * TURN * Rotation.from_matrix(rotation)
        assert apart.magnitude() <= TOLERANCE


def answers(graph, cloud, model, **parameters):
    """The messages of `grasps`, `touch` and `markers` for one cloud."""
    graph.add(*PERCEPTION, model=model, **parameters)
    heard = [
        graph.listen(kind, topic)
        for kind, topic in ((GraspArray, "grasps"), (TouchPredictionArray, "touch"), (MarkerArray, "markers"))
    ]
    camera = graph.talk(PointCloud2, "points")
    for topic, senders in (("points", 1), ("object_cloud", 1), ("grasps", 1), ("touch", 1), ("markers", 2)):
        graph.matched(topic, senders)
    camera.publish(cloud_to_msg(cloud))
    graph.until(lambda: heard[0] and heard[1])
    return heard


@pytest.mark.parametrize("direct", [True, False])
def test_a_grasp_in_the_frame_of_the_robot_is_the_truth(graph, cloud, truth, model_card, hand_eye, direct):
    grasps, touch, markers = answers(
        graph, cloud, model_card, output_frame="base_link", hand_eye=hand_eye, direct=direct, grasp__method="original"
    )
    target, _ = truth
    best = grasps[0].grasps[0]
    config = graph.nodes[1].config.grasp
    plan = Pipeline(PipelineConfig(grasp=config)).plan(target).grasps[0]
    assert (grasps[0].header.frame_id, grasps[0].status) == ("base_link", Status.OK)
    check_grasp(best, plan.g1, plan.g2, plan.rotation)
    prediction = touch[0].predictions[0]
    assert touch[0].header.frame_id == prediction.header.frame_id == "base_link"
    assert touch[0].header.stamp == grasps[0].header.stamp
    assert prediction.grasp == best
    (expected,) = load_model(model_card).predict(target.cloud, [plan])
    assert_allclose(prediction.pdc_mf.value, expected.value.pdc_mf, rtol=1e-5)
    graph.until(lambda: any(one.ns == "contacts" for message in markers for one in message.markers))
    drawn = [one for message in markers for one in message.markers if one.ns in {"contacts", "thumb"}]
    assert {one.header.frame_id for one in drawn} == {"base_link"}
    balls = [one for one in drawn if one.type == Marker.SPHERE]
    for ball, contact in zip(balls, (plan.g1, plan.g2), strict=True):
        assert np.linalg.norm(xyz_of(ball.pose.position) - in_base(contact)) <= TOLERANCE


def test_the_default_is_the_frame_of_the_cloud(graph, cloud, truth, model_card):
    grasps, touch, _ = answers(graph, cloud, model_card)
    assert grasps[0].header.frame_id == touch[0].header.frame_id == CAMERA
    assert touch[0].predictions[0].grasp == grasps[0].grasps[0]


def test_a_prediction_in_another_frame_than_its_cloud_is_not_drawn(graph, cloud, model_card, hand_eye):
    monitor = MonitorNode(with_clouds=True)
    graph._executor.add_node(monitor)
    graph.nodes.append(monitor)
    graph.add(*PERCEPTION, model=model_card, output_frame="base_link", hand_eye=hand_eye)
    camera = graph.talk(PointCloud2, "points")
    for topic in ("points", "object_cloud", "grasps", "touch"):
        graph.matched(topic)
    camera.publish(cloud_to_msg(cloud))
    graph.until(lambda: monitor.view().last is not None)
    assert monitor.view().answers == {"ok": 1}
    assert monitor.last_drawables() == []


@pytest.fixture
def tf2(monkeypatch) -> type[tf2_stand_in.Buffer]:
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2_stand_in.module())
    return tf2_stand_in.Buffer


def test_a_moving_camera_is_looked_up_at_the_stamp_and_a_missing_transform_is_no_transform(
    graph, scene_cloud, model_card, tf2
):
    """The camera turns by 90 degrees in a second; the cloud of a later time finds no transform."""
    turns = Rotation.from_euler("z", [[0.0], [90.0]], degrees=True).as_quat()
    begin = 1_700_000_000_000_000_000
    tf2.known["base_link", CAMERA] = [(begin, SHIFT, turns[0]), (begin + 10**9, SHIFT, turns[1])]
    grasps, touch, _ = answers(
        graph, scene_cloud(stamp_ns=begin + 10**9 // 2), model_card, output_frame="base_link", transform_timeout_s=0.01
    )
    planned = Pipeline(PipelineConfig(grasp=graph.nodes[1].config.grasp))
    plan = planned.plan(planned.segment(scene_cloud()).targets[0]).grasps[0]
    half = Rotation.from_euler("z", 45.0, degrees=True)
    for message in (grasps[0].grasps[0], touch[0].predictions[0].grasp):
        assert np.linalg.norm(xyz_of(message.g1) - (half.apply(plan.g1) + SHIFT)) <= TOLERANCE
    camera = graph.talk(PointCloud2, "points")
    graph.matched("points", 2)
    camera.publish(cloud_to_msg(scene_cloud(stamp_ns=begin + 2 * 10**9)))
    graph.until(lambda: len(grasps) == 2 and len(touch) == 2)
    for message in (grasps[1], touch[1]):
        assert message.status == Status.UNKNOWN_FRAME
        assert message.reason.startswith("no_transform: from 'camera_depth_optical_frame' to 'base_link': Lookup would")
    assert (len(grasps[1].grasps), len(touch[1].predictions)) == (0, 0)


def predictor(graph, model, **parameters) -> ForetouchNode:
    (node,) = graph.add("touch_predictor", model=model, output_frame="base_link", **parameters)
    return node


def ask(graph, request):
    return graph.call(PredictTouch, "predict_touch", request).touch


def test_requests_are_answered_in_the_frame_of_the_robot_from_either_frame(graph, truth, model_card, hand_eye):
    predictor(graph, model_card, hand_eye=hand_eye)
    target, plan = truth
    cloud = objects_to_msg([target], CAMERA, 5)
    grasps, table = [grasp_to_msg(one) for one in plan], plane_to_msg(target.plane)
    there = ask(graph, PredictTouch.Request(cloud=cloud, grasps=grasps, table=[table]))
    moved = [TO_BASE.grasp(one) for one in grasps]
    request = PredictTouch.Request(cloud=TO_BASE.cloud(cloud), grasps=moved, table=[TO_BASE.plane(table)])
    here = ask(graph, request)
    expected = load_model(model_card).predict(target.cloud, plan)
    for answer, tolerance in ((there, 1e-6), (here, 1e-4)):  # the points in base_link are rounded to float32
        assert (answer.header.frame_id, answer.status) == ("base_link", Status.OK), answer.reason
        for found, one, grasp in zip(answer.predictions, expected, plan, strict=True):
            check_grasp(found.grasp, grasp.g1, grasp.g2, grasp.rotation)
            assert_allclose(found.pdc_th.value, one.value.pdc_th, rtol=tolerance)
    sent = [(one.g1, one.g2, one.pose) for one in moved]
    assert [(one.grasp.g1, one.grasp.g2, one.grasp.pose) for one in here.predictions] == sent
    request.grasps[0].rotation = np.zeros(9)
    request.grasps[0].pose.orientation.x = request.grasps[0].pose.orientation.y = 0.0
    request.grasps[0].pose.orientation.z = request.grasps[0].pose.orientation.w = 0.0
    posed = ask(graph, request).predictions[0]
    (again,) = load_model(model_card).predict(target.cloud, [Pipeline().grasp_between(target, plan[0].g1, plan[0].g2)])
    assert_allclose(posed.pdc_th.value, again.value.pdc_th, rtol=1e-3)


def test_a_cloud_in_the_frame_of_a_link_is_refused_by_name(graph, truth, model_card):
    graph.add("touch_predictor", model=model_card)
    target, plan = truth
    link = FrameTransform("camera_link", CAMERA, np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float), np.zeros(3))
    cloud = link.cloud(objects_to_msg([target], CAMERA, 5))
    answer = ask(graph, PredictTouch.Request(cloud=cloud, grasps=[link.grasp(grasp_to_msg(plan[0]))]))
    assert answer.status == Status.UNKNOWN_FRAME
    assert "frame 'camera_link': not_optical: " in answer.reason
    assert "in view along x, as in the frame of a link" in answer.reason


def test_objects_in_the_frame_of_a_link_get_no_grasp_and_no_prediction(graph, truth, model_card):
    graph.add("grasp", "touch_predictor", model=model_card)
    target, _ = truth
    heard = [graph.listen(GraspArray, "grasps"), graph.listen(TouchPredictionArray, "touch")]
    clouds, tables = graph.talk(PointCloud2, "object_cloud"), graph.talk(TablePlane, "table")
    for topic in ("object_cloud", "table", "grasps", "touch"):
        graph.matched(topic)
    link = FrameTransform("camera_link", CAMERA, np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float), np.zeros(3))
    tables.publish(TablePlane(header=header_to_msg("camera_link", 5), plane=link.plane(plane_to_msg(target.plane))))
    clouds.publish(link.cloud(objects_to_msg([target], CAMERA, 5)))
    graph.until(lambda: heard[0] and heard[1])
    for (message,) in heard:
        assert message.status == Status.UNKNOWN_FRAME
        assert message.reason.startswith("cloud: frame 'camera_link': not_optical: ")


def test_a_header_alone_asks_about_the_latest_object(graph, cloud, truth, model_card, hand_eye):
    (grasps, touch, _) = answers(graph, cloud, model_card, output_frame="base_link", hand_eye=hand_eye)
    request = PredictTouch.Request(cloud=PointCloud2(header=header_to_msg("base_link", 0)), grasps=grasps[0].grasps)
    answer = ask(graph, request)
    assert answer.header == touch[0].header
    assert_allclose(answer.predictions[0].pdc_th.value, touch[0].predictions[0].pdc_th.value, rtol=1e-6)
    check_grasp(
        answer.predictions[0].grasp, *(getattr(_back(grasps[0].grasps[0]), n) for n in ("g1", "g2", "rotation"))
    )
    request.cloud.header.frame_id = "world"
    answer = ask(graph, request)
    assert answer.status == Status.UNKNOWN_FRAME
    assert answer.reason == f"cloud: frame 'world' of the request is not '{CAMERA}' or 'base_link'"


def _back(message: Grasp):
    from foretouch.dataset.messages import decode_grasp

    return decode_grasp(TO_BASE.inverse().grasp(message))


def test_a_header_alone_before_the_first_object_is_refused(graph, truth, model_card, tf2):
    predictor(graph, model_card)
    _, plan = truth
    grasp = grasp_to_msg(plan[0])
    answer = ask(graph, PredictTouch.Request(cloud=PointCloud2(header=header_to_msg("base_link", 0)), grasps=[grasp]))
    assert answer.status == Status.EMPTY_CLOUD
    target, _ = truth
    answer = ask(graph, PredictTouch.Request(cloud=objects_to_msg([target], "base_link", 5), grasps=[grasp]))
    assert (answer.status, answer.reason) == (
        Status.UNKNOWN_FRAME,
        "no_transform: the frame of the camera is not known before the first object_cloud",
    )


def test_sampled_grasps_and_their_feedback_are_in_the_frame_of_the_robot(graph, truth, model_card, hand_eye):
    predictor(graph, model_card, hand_eye=hand_eye)
    target, _ = truth
    client = graph.action_client(SampleGrasps, "sample_grasps")
    feedback = []
    goal = SampleGrasps.Goal(cloud=objects_to_msg([target], CAMERA, 5), table=[plane_to_msg(target.plane)], count=5)
    sent = client.send_goal_async(goal, feedback_callback=lambda m: feedback.append(m.feedback))
    graph.until(sent.done)
    future = sent.result().get_result_async()
    graph.until(lambda: future.done() and feedback)
    result = future.result().result
    plan = Pipeline(PipelineConfig(grasp=graph.nodes[0].config.grasp.replace(count=5))).plan(target).grasps
    by_id = {one.id: one for one in result.grasps}
    assert result.grasp_state == "success"
    assert {one.header.frame_id for one in (*result.grasp_candidates, *feedback[0].grasp_candidates)} == {"base_link"}
    for one in plan:
        found = min(by_id.values(), key=lambda g: np.linalg.norm(xyz_of(g.g1) - in_base(one.g1)))
        check_grasp(found, one.g1, one.g2, one.rotation)
    for pose, grasp, prediction in zip(result.grasp_candidates, result.grasps, result.predictions, strict=True):
        assert pose.pose == grasp.pose == prediction.grasp.pose
    assert {one.id for one in feedback[0].grasps} == set(by_id)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"output_frame": "base_link"}, "needs tf2_ros, which is not installed"),
        ({"output_frame": "base_link", "hand_eye": "/nope.yaml"}, "/nope.yaml"),
    ],
)
@pytest.mark.parametrize("name", ["grasp", "touch_predictor"])
def test_a_frame_without_a_transform_refuses_to_configure_in_one_line(
    graph, model_card, monkeypatch, name, parameters, reason
):
    said = []
    monkeypatch.setattr(ForetouchNode, "_attempt", _recorded(said))
    (node,) = graph.add(name, **parameters, **({"model": model_card} if name == "touch_predictor" else {}))
    assert node.state_name == "unconfigured"
    assert len(said) == 1
    assert reason in said[0]


def _recorded(said: list[str]):
    def attempt(_node, hook) -> bool:
        try:
            hook()
        except ForetouchError as err:
            said.append(str(err))
            return False
        return True

    return attempt
