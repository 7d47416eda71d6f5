# SPDX-License-Identifier: Apache-2.0
"""The service, the action, and a model that cannot be loaded."""

import math
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from calibrated_models import save_calibrated_network
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Quaternion
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

from foretouch.grasp import GeoGraspConfig
from foretouch.models import load_model
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg
from foretouch.ros.messages.requests import plan_targets
from foretouch.types import Cloud
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import GraspArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def target(scene_cloud):
    """One object of a scene, on which ten pairs rank."""
    return Pipeline().segment(scene_cloud(n_objects=3, width=848)).targets[0]


@pytest.fixture(scope="module")
def plan(target):
    return Pipeline(PipelineConfig(grasp=GeoGraspConfig(count=10))).plan(target)


def request_of(target, grasps, table=True):
    return PredictTouch.Request(
        cloud=objects_to_msg([target], "cam", 5),
        grasps=[grasp_to_msg(grasp) for grasp in grasps],
        table=[plane_to_msg(target.plane)] if table else [],
    )


def ask(graph, request):
    return graph.call(PredictTouch, "predict_touch", request).touch


def test_many_grasps_are_answered_in_order_with_the_models_own_numbers(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    answer = ask(graph, request_of(target, plan.grasps))
    expected = load_model(model_card).predict(target.cloud, plan.grasps)
    assert len(answer.predictions) == len(plan.grasps) > 1
    assert answer.header.frame_id == "cam"
    for message, prediction in zip(answer.predictions, expected, strict=True):
        assert message.status == Status.OK
        assert message.pdc_th.value == np.float32(prediction.value.pdc_th)
        np.testing.assert_array_equal([i.value for i in message.e_mf], prediction.value.e_mf.astype(np.float32))


def test_a_grasp_without_orientation_is_posed_on_the_table(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:1])
    request.grasps[0].rotation = np.zeros(9)
    request.grasps[0].pose.orientation.x = request.grasps[0].pose.orientation.y = 0.0
    request.grasps[0].pose.orientation.z = request.grasps[0].pose.orientation.w = 0.0
    (posed,) = ask(graph, request).predictions
    grasp = Pipeline().grasp_between(target, plan.grasps[0].g1, plan.grasps[0].g2)
    (expected,) = load_model(model_card).predict(target.cloud, [grasp])
    assert posed.pdc_mf.value == np.float32(expected.value.pdc_mf)
    request.table = []
    (refused,) = ask(graph, request).predictions
    assert refused.status == Status.BAD_GRASP
    assert "no orientation" in refused.reason


def test_one_bad_grasp_does_not_spoil_the_others(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:3])
    request.grasps[1].g1.x = math.nan
    answer = ask(graph, request)
    assert [p.status for p in answer.predictions] == [Status.OK, Status.BAD_GRASP, Status.OK]
    assert "g1" in answer.predictions[1].reason
    assert math.isnan(answer.predictions[1].pdc_th.value)
    assert answer.status == Status.OK


@pytest.mark.parametrize(
    ("spoil", "status", "reason"),
    [
        (lambda r: setattr(r, "grasps", []), Status.NO_GRASP, "grasps: is empty"),
        (lambda r: setattr(r, "cloud", PointCloud2()), Status.BAD_CLOUD, "x is missing"),
        (lambda r: setattr(r.cloud, "row_step", 1), Status.BAD_CLOUD, "row_step"),
        (lambda r: setattr(r.table[0], "coef", np.full(4, math.nan)), Status.BAD_PLANE, "finite"),
        (lambda r: setattr(r.table[0], "coef", np.zeros(4)), Status.BAD_PLANE, "holds no plane"),
        (lambda r: setattr(r.table[0], "coef", np.full(4, 1e308)), Status.BAD_PLANE, "beyond 1e+100"),
        (lambda r: setattr(r.table[0], "coef", [0.0, 0.0, 1.0, 1e20]), Status.BAD_PLANE, "farther away than 1000 m"),
        (lambda r: setattr(r.grasps[0].pose.orientation, "x", 1e160), Status.BAD_GRASP, "is not 1"),
        (lambda r: setattr(r.grasps[0], "rotation", np.full(9, 1e160)), Status.BAD_GRASP, "is not a rotation"),
        (lambda r: setattr(r.grasps[0], "object_id", "77"), Status.BAD_GRASP, "'77' is none of"),
    ],
)
def test_a_request_that_cannot_be_answered_says_why(graph, model_card, target, plan, spoil, status, reason):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:1])
    spoil(request)
    answer = ask(graph, request)
    assert answer.status == status
    assert reason in answer.reason


def test_points_in_one_place_are_named(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:1])
    request.cloud = cloud_to_msg(Cloud(np.full((500, 3), 0.7, np.float32), frame_id="cam"))
    request.grasps[0].g1, request.grasps[0].g2 = Point(x=0.7, y=0.72, z=0.7), Point(x=0.7, y=0.68, z=0.7)
    answer = ask(graph, request)
    assert answer.status == Status.TOO_FEW_POINTS
    assert answer.reason


@pytest.fixture
def damaged_card(model_card, tmp_path):
    """The model with one byte of its weights changed."""
    for path in (Path(model_card), Path(model_card).with_suffix(".safetensors")):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    weights = tmp_path / "small.safetensors"
    data = bytearray(weights.read_bytes())
    data[-1] ^= 0xFF
    weights.write_bytes(data)
    return str(tmp_path / "small.json")


def test_a_damaged_model_is_named_and_the_node_stays_up(graph, damaged_card, target, plan):
    graph.add("touch_predictor", model=damaged_card, diagnostics_period_s=0.1)
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    answer = ask(graph, request_of(target, plan.grasps[:2]))
    assert answer.status == Status.NO_MODEL
    assert "sha256" in answer.reason
    assert len(answer.predictions) == 2
    graph.until(lambda: reports)
    assert reports[-1].status[0].level == DiagnosticStatus.ERROR
    assert "sha256" in reports[-1].status[0].message


def test_a_fallback_is_used_and_flagged(graph, damaged_card, model_card, target, plan):
    graph.add("touch_predictor", model=damaged_card, fallback_model=model_card)
    (prediction,) = ask(graph, request_of(target, plan.grasps[:1])).predictions
    assert prediction.status == Status.OK
    assert "fallback_model" in prediction.flags


def test_grasps_in_another_frame_are_refused(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    heard = graph.listen(TouchPredictionArray, "touch")
    clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
    for topic in ("object_cloud", "grasps", "touch"):
        graph.matched(topic)
    clouds.publish(objects_to_msg([target], "cam", 5))
    grasps.publish(GraspArray(header=header_to_msg("base", 5), grasps=[grasp_to_msg(plan.grasps[0])]))
    graph.until(lambda: heard)
    assert heard[0].status == Status.UNKNOWN_FRAME
    assert "'base' is not the cloud's, 'cam'" in heard[0].reason


class Sampler:
    """A client of the action."""

    def __init__(self, graph):
        self.graph = graph
        self.feedback = []
        self.client = graph.action_client(SampleGrasps, "sample_grasps")

    def sample(self, goal):
        sent = self.client.send_goal_async(goal, feedback_callback=lambda m: self.feedback.append(m.feedback))
        self.graph.until(sent.done)
        result = sent.result().get_result_async()
        self.graph.until(result.done)
        return result.result().result


def goal_of(target, **fields):
    return SampleGrasps.Goal(
        cloud=objects_to_msg([target], "cam", 5), table=[plane_to_msg(target.plane)], count=5, **fields
    )


def test_sampled_grasps_come_cheapest_first_and_match_their_poses(graph, model_card, target):
    graph.add("touch_predictor", model=model_card)
    sampler = Sampler(graph)
    result = sampler.sample(goal_of(target))
    assert result.grasp_state == "success"
    assert len(result.costs) == len(result.grasps) == len(result.grasp_candidates) == len(result.predictions) == 5
    assert list(result.costs) == sorted(result.costs)
    for pose, grasp in zip(result.grasp_candidates, result.grasps, strict=True):
        assert pose.pose == grasp.pose
        assert pose.header.frame_id == "cam"
    first = result.predictions[0]
    share = ((first.pdc_th.value - 2500) / 900 + (first.pdc_mf.value - 1600) / 700) / 2
    assert result.costs[0] == pytest.approx(share, rel=1e-5)
    graph.until(lambda: sampler.feedback)
    assert sorted(sampler.feedback[0].costs) == list(result.costs)


def test_the_score_can_be_the_cost(graph, model_card, target):
    graph.add("touch_predictor", model=model_card)
    result = Sampler(graph).sample(goal_of(target, cost=SampleGrasps.Goal.SCORE))
    plan = Pipeline(PipelineConfig(grasp=GeoGraspConfig(count=5))).plan(target)
    np.testing.assert_allclose(result.costs, [-grasp.score for grasp in plan.grasps], rtol=1e-6)


@pytest.mark.parametrize(
    ("spoil", "status", "reason"),
    [
        (lambda g: setattr(g, "cost", "beauty"), Status.BAD_REQUEST, "'beauty' is none of pressure, score"),
        (lambda g: setattr(g, "table", []), Status.BAD_PLANE, "needed with a cloud"),
        (lambda g: setattr(g, "cloud", PointCloud2()), Status.EMPTY_CLOUD, "no object_cloud with a table"),
    ],
)
def test_a_goal_that_cannot_be_met_says_why(graph, model_card, target, spoil, status, reason):
    graph.add("touch_predictor", model=model_card)
    goal = goal_of(target)
    spoil(goal)
    result = Sampler(graph).sample(goal)
    assert result.status == status
    assert reason in result.grasp_state
    assert not result.costs


def test_without_a_cloud_the_latest_object_is_sampled(graph, model_card, target):
    (node,) = graph.add("touch_predictor", model=model_card)
    clouds, tables = graph.talk(PointCloud2, "object_cloud"), graph.talk(TablePlane, "table")
    grasps = graph.talk(GraspArray, "grasps")
    for topic in ("object_cloud", "table", "grasps"):
        graph.matched(topic)
    header = header_to_msg("cam", 11)
    tables.publish(TablePlane(header=header, plane=plane_to_msg(target.plane)))
    clouds.publish(objects_to_msg([target], "cam", 11))
    grasps.publish(GraspArray(header=header, status=Status.NO_GRASP, reason="none"))
    graph.until(lambda: node.statistics.summary().used == 1)
    result = Sampler(graph).sample(SampleGrasps.Goal(count=2))
    assert result.grasp_state == "success"
    assert result.grasp_candidates[0].header == header


def test_cleaning_up_and_configuring_again_restores_service_and_action(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    assert ask(graph, request_of(target, plan.grasps[:1])).status == Status.OK
    for transition in ("deactivate", "cleanup"):
        request = ChangeState.Request(transition=Transition(label=transition))
        assert graph.call(ChangeState, "touch_predictor/change_state", request).success
    graph.until(lambda: not graph.probe.count_services("/foretouch/predict_touch"))
    for transition in ("configure", "activate"):
        request = ChangeState.Request(transition=Transition(label=transition))
        assert graph.call(ChangeState, "touch_predictor/change_state", request).success
    assert ask(graph, request_of(target, plan.grasps[:1])).status == Status.OK
    assert Sampler(graph).sample(goal_of(target)).grasp_state == "success"


def test_a_contact_at_1e160_m_is_refused_and_the_next_request_answered(graph, model_card, target, plan):
    (node,) = graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:3])
    request.grasps[1].g1.x = 1e160
    answer = ask(graph, request)
    assert [p.status for p in answer.predictions] == [Status.OK, Status.BAD_GRASP, Status.OK]
    assert answer.predictions[1].reason == "g1, g2: 1e+160 m apart, more than max_width_m 0.2"
    assert ask(graph, request_of(target, plan.grasps[:1])).status == Status.OK
    assert not node.internal_errors.counts()


@pytest.mark.parametrize(
    ("move", "reason"),
    [
        (lambda g: setattr(g.g1, "x", g.g1.x + 1.0), "m apart, more than max_width_m 0.2"),
        (
            lambda g: (setattr(g.g1, "y", g.g1.y + 50.0), setattr(g.g2, "y", g.g2.y + 50.0)),
            "m from the object, more than max_distance_m 0.1",
        ),
    ],
)
def test_a_grasp_out_of_reach_is_refused_by_name(graph, model_card, target, plan, move, reason):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:2])
    move(request.grasps[0])
    refused, fine = ask(graph, request).predictions
    assert (refused.status, fine.status) == (Status.BAD_GRASP, Status.OK)
    assert reason in refused.reason


@pytest.fixture(params=["plain", "calibrated"])
def any_card(request, model_card, tmp_path):
    """A model whose predictions pass the online adaptation, and one that has none."""
    return model_card if request.param == "plain" else save_calibrated_network(tmp_path)


def test_the_reach_is_that_of_the_parameters_and_of_nothing_else(graph, any_card, target, plan):
    (node,) = graph.add("touch_predictor", model=any_card, max_width_m=0.4, max_distance_m=0.5)
    request = request_of(target, plan.grasps[:3])
    first, second, _ = request.grasps
    first.g1.x = first.g2.x + 0.35
    second.g1.x = second.g2.x + 0.45
    wide, wider, fine = ask(graph, request).predictions
    assert (wide.status, fine.status) == (Status.OK, Status.OK), wide.reason
    assert (wider.status, wider.model) == (Status.BAD_GRASP, fine.model)
    assert "m apart, more than max_width_m 0.4" in wider.reason
    node.set_parameters([Parameter("max_width_m", value=0.3)])
    wide, *_ = ask(graph, request).predictions
    assert (wide.status, "more than max_width_m 0.3" in wide.reason) == (Status.BAD_GRASP, True)


def test_the_reach_of_the_node_is_by_default_that_of_the_command_line(graph, model_card):
    (node,) = graph.add("touch_predictor", model=model_card)
    config, default = node.config, PipelineConfig()
    assert (config.max_width_m, config.max_distance_m) == (default.reach.max_width_m, default.reach.max_distance_m)
    assert config.limits == default.limits


def test_the_limits_of_objects_are_parameters_and_named(graph, any_card, target, plan):
    (node,) = graph.add("touch_predictor", model=any_card, limits__max_extent_m=0.03)
    answer = ask(graph, request_of(target, plan.grasps[:2]))
    assert (answer.status, len(answer.predictions)) == (Status.BAD_CLOUD, 2)
    assert "more than max_extent_m 0.03" in answer.reason
    result = Sampler(graph).sample(goal_of(target))
    assert (result.status, "more than max_extent_m 0.03" in result.grasp_state) == (Status.NO_GRASP, True)
    house = [Parameter("limits.max_extent_m", value=5.0), Parameter("max_distance_m", value=5.0)]
    assert all(one.successful for one in node.set_parameters(house))
    request = request_of(target, plan.grasps[:1])
    points = np.concatenate([target.cloud.xyz, target.cloud.xyz + np.float32([2.0, 0.0, 0.0])])
    request.cloud = cloud_to_msg(Cloud(points, frame_id="cam"))
    assert ask(graph, request).status == Status.OK


def test_a_table_behind_the_camera_poses_no_grasp(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:1])
    request.table[0].coef = [0.0, 0.0, 1.0, 1.0]
    assert ask(graph, request).status == Status.OK  # it has its orientation
    request.grasps[0].rotation = np.zeros(9)
    request.grasps[0].pose.orientation = Quaternion(w=0.0)
    answer = ask(graph, request)
    assert (answer.status, "is behind the camera" in answer.reason) == (Status.BAD_PLANE, True)


def test_contacts_far_away_without_orientation_are_refused_by_their_width(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card)
    request = request_of(target, plan.grasps[:1])
    request.grasps[0].rotation = np.zeros(9)
    request.grasps[0].pose.orientation = Quaternion(w=0.0)
    for far in (1e160, 1e300):
        request.grasps[0].g1.x = far
        answer = ask(graph, request)
        assert (answer.status, "more than max_width_m" in answer.reason) == (Status.BAD_GRASP, True), answer.reason


def test_a_request_with_too_many_grasps_is_refused(graph, model_card, target, plan):
    graph.add("touch_predictor", model=model_card, max_grasps=3)
    assert ask(graph, request_of(target, plan.grasps[:3])).status == Status.OK
    answer = ask(graph, request_of(target, plan.grasps[:4]))
    assert (answer.status, answer.reason) == (Status.BAD_REQUEST, "grasps: 4 is above max_grasps, 3")
    result = Sampler(graph).sample(goal_of(target, cost=SampleGrasps.Goal.SCORE))
    assert (result.status, result.grasp_state) == (Status.BAD_REQUEST, "bad_request: count: 5 is above max_grasps, 3")


def test_an_internal_error_becomes_a_status_with_a_reason(graph, model_card, target, plan, monkeypatch):
    (node,) = graph.add("touch_predictor", model=model_card)

    def fail(*_, **__):
        raise FloatingPointError("overflow")

    monkeypatch.setattr(type(node._predictor), "array", fail)
    answer = ask(graph, request_of(target, plan.grasps[:1]))
    assert (answer.status, answer.reason) == (Status.FAILED, "FloatingPointError: overflow")
    assert answer.header.frame_id == "cam"
    result = Sampler(graph).sample(goal_of(target))
    assert (result.status, result.grasp_state) == (Status.FAILED, "failed: FloatingPointError: overflow")
    assert node.internal_errors.counts() == {"predict_touch": 1, "sample_grasps": 1}
    monkeypatch.undo()
    assert ask(graph, request_of(target, plan.grasps[:1])).status == Status.OK


def test_a_cancel_is_honoured_within_a_hundred_grasps(graph, model_card, target, monkeypatch):
    (node,) = graph.add("touch_predictor", model=model_card)
    sampler = Sampler(graph)
    real, sizes, handles = type(node._predictor).array, [], []

    def many(pipeline, targets, header):
        array = plan_targets(pipeline, targets, header)
        array.grasps = list(array.grasps) * 1000
        return array

    def slow(predictor, targets, grasps, *rest):
        sizes.append(len(grasps))
        if len(sizes) == 2:
            cancelled = handles[0].cancel_goal_async()
            graph.until(cancelled.done)
        return real(predictor, targets, grasps, *rest)

    monkeypatch.setattr("foretouch.ros.messages.requests.plan_targets", many)
    monkeypatch.setattr(type(node._predictor), "array", slow)
    sent = sampler.client.send_goal_async(goal_of(target))
    sent.add_done_callback(lambda future: handles.append(future.result()))
    graph.until(lambda: handles)
    future = handles[0].get_result_async()
    graph.until(future.done)
    answer = future.result()
    assert sizes == [100, 100]
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert len(answer.result.grasps) == 200
