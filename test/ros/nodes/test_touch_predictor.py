# SPDX-License-Identifier: Apache-2.0
"""The service, the action, and a model that cannot be loaded."""

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from calibrated_models import save_calibrated_network
from diagnostic_msgs.msg import DiagnosticStatus
from every_case import every_case
from geometry_msgs.msg import Point, Quaternion
from sensor_msgs.msg import PointCloud2

from foretouch import reading
from foretouch.grasp import GeoGraspConfig
from foretouch.models import load_model
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, plane_to_msg
from foretouch.ros.messages.requests import plan_targets
from foretouch.ros.runtime.lifecycle_node import REQUESTS
from foretouch.types import Cloud
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import BiotacAll, Grasp, GraspArray, Status, TablePlane, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def target(scene_cloud):
    """One object of a scene, on which ten pairs rank."""
    return Pipeline().segment(scene_cloud(n_objects=3, width=848)).targets[0]


@pytest.fixture(scope="module")
def grasps(target):
    return Pipeline(PipelineConfig(grasp=GeoGraspConfig(count=10))).plan(target).grasps


class Planner:
    """Requests and goals on one target, for a predictor with these parameters."""

    def __init__(self, graph, target, grasps, **parameters):
        (self.node,) = graph.add("touch_predictor", **parameters)
        self.graph, self.target, self.grasps, self.feedback = graph, target, grasps, []

    def request(self, count=1):
        messages, table = [grasp_to_msg(one) for one in self.grasps[:count]], [plane_to_msg(self.target.plane)]
        return PredictTouch.Request(cloud=objects_to_msg([self.target], "cam", 5), grasps=messages, table=table)

    def ask(self, request=None, field="touch"):
        return getattr(self.graph.call(PredictTouch, "predict_touch", request or self.request()), field)

    def goal(self, **fields):
        table = [plane_to_msg(self.target.plane)]
        return SampleGrasps.Goal(cloud=objects_to_msg([self.target], "cam", 5), table=table, count=5, **fields)

    def sample(self, goal=None):
        _, result, self.feedback = self.graph.goal(SampleGrasps, "sample_grasps", goal or self.goal())
        return result


@pytest.fixture
def planner(graph, target, grasps, model_card):
    return Planner(graph, target, grasps, model=model_card)


def oriented(message, orientation):
    """The message with this orientation alone."""
    message.rotation, message.pose.orientation = np.zeros(9), orientation
    return message


def without_orientation(message):
    return oriented(message, Quaternion(w=0.0))


def test_grasps_are_answered_in_order_with_the_models_numbers_and_posed_if_need_be(planner, model_card):
    answer = planner.ask(planner.request(10))
    expected = load_model(model_card).predict(planner.target.cloud, planner.grasps)
    assert len(answer.predictions) == len(planner.grasps) > 1
    assert answer.header.frame_id == "cam"
    for message, prediction in zip(answer.predictions, expected, strict=True):
        assert message.status == Status.OK
        assert reading(message)["PDC"][0] == np.float32(prediction.value["PDC_TH"][0])
        np.testing.assert_array_equal(reading(message)["E"][1].tolist(), prediction.value["E_MF"].astype(np.float32))
    request = planner.request()
    without_orientation(request.grasps[0])
    (posed,) = planner.ask(request).predictions
    grasp = Pipeline().grasp_between(planner.target, planner.grasps[0].g1, planner.grasps[0].g2)
    (expected,) = load_model(model_card).predict(planner.target.cloud, [grasp])
    assert reading(posed)["PDC"][1] == np.float32(expected.value["PDC_MF"][0])
    request.table[0].coef = [0.0, 0.0, 1.0, 1.0]
    answer = planner.ask(request)
    assert (answer.status, "is behind the camera" in answer.reason) == (Status.BAD_PLANE, True)
    request.table = []
    (refused,) = planner.ask(request).predictions
    assert (refused.status, "no orientation" in refused.reason) == (Status.BAD_GRASP, True)


def test_a_request_or_grasp_that_cannot_be_answered_is_refused_with_the_reason_and_the_others_are_not(planner):
    def check(reason, status, spoil):
        request = planner.request()
        spoil(request)
        answer = planner.ask(request)
        assert answer.status == status
        assert reason in answer.reason

    def one_place(r):
        r.cloud = cloud_to_msg(Cloud(np.full((500, 3), 0.7, np.float32), frame_id="cam"))
        r.grasps[0].g1, r.grasps[0].g2 = Point(x=0.7, y=0.72, z=0.7), Point(x=0.7, y=0.68, z=0.7)

    def far_without_orientation(r):
        without_orientation(r.grasps[0]).g1.x = 1e160

    cases = [
        ("grasps: is empty", Status.NO_GRASP, lambda r: setattr(r, "grasps", [])),
        ("x is missing", Status.BAD_CLOUD, lambda r: setattr(r, "cloud", PointCloud2())),
        ("row_step", Status.BAD_CLOUD, lambda r: setattr(r.cloud, "row_step", 1)),
        ("finite", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", np.full(4, math.nan))),
        ("holds no plane", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", np.zeros(4))),
        ("beyond 1e+100", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", np.full(4, 1e308))),
        ("farther away than 1000 m", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", [0.0, 0.0, 1.0, 1e20])),
        ("is not 1", Status.BAD_GRASP, lambda r: setattr(r.grasps[0].pose.orientation, "x", 1e160)),
        ("degrees from g1 - g2, more than 30", Status.BAD_GRASP, lambda r: oriented(r.grasps[0], Quaternion())),
        ("is not a rotation", Status.BAD_GRASP, lambda r: setattr(r.grasps[0], "rotation", np.full(9, 1e160))),
        ("'77' is not one of", Status.BAD_GRASP, lambda r: setattr(r.grasps[0], "object_id", "77")),
        ("1e+160 m apart, more than max_width_m 0.2", Status.BAD_GRASP, far_without_orientation),
        ("", Status.TOO_FEW_POINTS, one_place),
        ("", Status.OK, lambda _: None),
    ]
    every_case(cases, check)
    assert not planner.node.internal_errors.counts()

    def shift(grasp):
        grasp.g1.y, grasp.g2.y = grasp.g1.y + 50.0, grasp.g2.y + 50.0

    for reason, move in (
        ("g1", lambda g: setattr(g.g1, "x", math.nan)),
        ("g1, g2: 1e+160 m apart, more than max_width_m 0.2", lambda g: setattr(g.g1, "x", 1e160)),
        ("m apart, more than max_width_m 0.2", lambda g: setattr(g.g1, "x", g.g1.x + 1.0)),
        ("m from the object, more than max_distance_m 0.1", shift),
    ):
        request = planner.request(3)
        move(request.grasps[1])
        answer = planner.ask(request)
        assert [answer.status, *(p.status for p in answer.predictions)] == [0, Status.OK, Status.BAD_GRASP, Status.OK]
        assert reason in answer.predictions[1].reason
        assert math.isnan(reading(answer.predictions[1])["PDC"][0])


def arrays_of(request, *, oriented=True):
    """The same request with arrays."""
    contacts = [value for one in request.grasps for p in (one.g1, one.g2) for value in (p.x, p.y, p.z)]
    turned = np.concatenate([one.rotation for one in request.grasps]) if oriented else []
    return PredictTouch.Request(cloud=request.cloud, table=request.table, contacts=contacts, rotations=turned)


def test_arrays_are_answered_with_the_numbers_of_messages_and_with_the_orientations_that_were_computed(planner):
    asked = planner.request(10)
    asked.grasps[2].g1.x += 1.0  # too wide
    for oriented in (True, False):
        if not oriented:
            for grasp in asked.grasps:
                without_orientation(grasp)
        messages, batch = planner.ask(asked).predictions, planner.ask(arrays_of(asked, oriented=oriented), "batch")
        found = reading(batch)
        assert batch.header == messages[0].header
        for k, message in enumerate(messages):
            assert (batch.statuses[k], batch.reasons[k]) == (message.status, message.reason)
            for name, values in reading(message).items():
                np.testing.assert_array_equal(found[name][k], values)
                np.testing.assert_array_equal(found[name].lower[k], values.lower)
            names = [name for name, has in zip(batch.flags, np.reshape(batch.flagged, (10, -1))[k], strict=True) if has]
            assert sorted(names) == sorted(message.flags)
        rotations = np.reshape(batch.rotations, (-1, 9))
        assert len(rotations) == (0 if oriented else 10)
        for rotation, message in zip(rotations, messages, strict=False):
            np.testing.assert_array_equal(rotation, message.grasp.rotation if message.status == Status.OK else rotation)
        assert batch.statuses[2] == Status.BAD_GRASP


def test_two_grasps_of_a_request_with_the_same_id_are_refused(planner):
    request = planner.request(count=3)
    for grasp, name in zip(request.grasps, ("a", "b", "a"), strict=True):
        grasp.id = name
    assert (planner.ask(request).status, planner.ask(request).reason) == (
        Status.BAD_REQUEST, "grasps: id 'a' occurs twice",
    )  # fmt: skip
    request.grasps[0].id = request.grasps[2].id = ""  # as many without as there are: none can be reported
    assert planner.ask(request).status == Status.OK


def test_arrays_that_cannot_be_answered_are_refused_with_the_reason(planner):
    def check(reason, status, spoil):
        request = arrays_of(planner.request())
        spoil(request)
        batch = planner.ask(request, "batch")
        assert batch.status == status
        assert reason in batch.reason

    cases = [
        (
            "contacts: 5 numbers are not a multiple of 6",
            Status.BAD_REQUEST,
            lambda r: setattr(r, "contacts", [0.0] * 5),
        ),
        ("rotations: 18 numbers are not 1 x 9", Status.BAD_REQUEST, lambda r: setattr(r, "rotations", [0.0] * 18)),
        ("rotations: 9 numbers are not 0 x 9", Status.BAD_REQUEST, lambda r: setattr(r, "contacts", [])),
        ("contacts: grasps are given too", Status.BAD_REQUEST, lambda r: setattr(r, "grasps", [Grasp()])),
        (
            "grasps: 1001 is above max_grasps, 1000",
            Status.BAD_REQUEST,
            lambda r: (setattr(r, "contacts", [0.0] * 6006), setattr(r, "rotations", [])),
        ),
        ("'77' is not one of", Status.BAD_GRASP, lambda r: setattr(r, "object_id", "77")),
        ("is not a rotation", Status.BAD_GRASP, lambda r: setattr(r, "rotations", [0.5] * 9)),
        ("is not finite", Status.BAD_GRASP, lambda r: setattr(r, "contacts", [math.nan] * 6)),
        ("both contacts are at", Status.BAD_GRASP, lambda r: setattr(r, "contacts", [0.7] * 6)),
        ("degrees from g1 - g2", Status.BAD_GRASP, lambda r: setattr(r, "rotations", np.eye(3)[[2, 0, 1]].ravel())),
        (
            "no table to compute it with",
            Status.BAD_GRASP,
            lambda r: (setattr(r, "rotations", []), setattr(r, "table", [])),
        ),
        ("x is missing", Status.BAD_CLOUD, lambda r: setattr(r, "cloud", PointCloud2())),
        ("", Status.OK, lambda _: None),
    ]
    every_case(cases, check)
    assert not planner.node.internal_errors.counts()


def test_a_damaged_model_is_named_and_the_fallback_used(graph, model_card, tmp_path, target, grasps):
    data = Path(model_card).with_suffix(".safetensors").read_bytes()
    (tmp_path / "small.json").write_bytes(Path(model_card).read_bytes())
    (tmp_path / "small.safetensors").write_bytes(data[:-1] + bytes([data[-1] ^ 0xFF]))
    reports, damaged = graph.reports("touch_predictor"), {"model": str(tmp_path / "small.json")}
    planner = Planner(graph, target, grasps, **damaged, diagnostics_period_s=0.1)
    answer = planner.ask(planner.request(2))
    assert (answer.status, len(answer.predictions), "sha256" in answer.reason) == (Status.NO_MODEL, 2, True)
    graph.until(lambda: reports)
    assert (reports[-1].level, "sha256" in reports[-1].message) == (DiagnosticStatus.ERROR, True)
    graph.remove(planner.node)
    (prediction,) = Planner(graph, target, grasps, **damaged, fallback_model=model_card).ask().predictions
    assert (prediction.status, "fallback_model" in prediction.flags) == (Status.OK, True)


def test_grasps_in_another_frame_are_refused_and_the_latest_object_is_sampled(graph, planner, grasps):
    heard = graph.listen(TouchPredictionArray, "touch")
    topics = {"object_cloud": PointCloud2, "grasps": GraspArray, "table": TablePlane}
    clouds, plans, tables = (graph.talk(kind, topic) for topic, kind in topics.items())
    graph.matched("touch", *topics)
    header = header_to_msg("cam", 11)
    tables.publish(TablePlane(header=header, plane=plane_to_msg(planner.target.plane)))
    graph.until(lambda: planner.node._tables)
    clouds.publish(objects_to_msg([planner.target], "cam", 11))
    plans.publish(GraspArray(header=header_to_msg("base", 11), grasps=[grasp_to_msg(grasps[0])]))
    graph.until(lambda: heard)
    assert heard[0].status == Status.UNKNOWN_FRAME
    assert "'base' is not the cloud's, 'cam'" in heard[0].reason
    result = planner.sample(SampleGrasps.Goal(count=2))
    assert (result.grasp_state, result.grasp_candidates[0].header) == ("success", header)


def test_sampled_grasps_come_cheapest_first_and_match_their_poses(graph, planner, target):
    result = planner.sample()
    assert result.grasp_state == "success"
    assert len(result.costs) == len(result.grasps) == len(result.grasp_candidates) == len(result.predictions) == 5
    assert list(result.costs) == sorted(result.costs)
    for pose, grasp in zip(result.grasp_candidates, result.grasps, strict=True):
        assert (pose.pose, pose.header.frame_id) == (grasp.pose, "cam")
    first = result.predictions[0]
    share = ((reading(first)["PDC"][0] - 2500) / 900 + (reading(first)["PDC"][1] - 1600) / 700) / 2
    assert result.costs[0] == pytest.approx(share, rel=1e-5)
    assert sorted(planner.feedback[0].costs) == list(result.costs)
    assert not any("equal_pressure" in one.flags for one in result.predictions)  # this model has no intervals
    by_score = planner.sample(planner.goal(cost=SampleGrasps.Goal.SCORE))
    plan = Pipeline(PipelineConfig(grasp=GeoGraspConfig(count=5))).plan(target)
    np.testing.assert_allclose(by_score.costs, [-grasp.score for grasp in plan.grasps], rtol=1e-6)


def test_costs_within_the_interval_of_the_lowest_are_equal_and_ordered_by_score(graph, target, grasps):
    planner = Planner(graph, target, grasps, model="default")
    result = planner.sample()
    scores = [one.score for one in result.grasps]
    assert (len(set(result.costs)), scores) == (1, sorted(scores, reverse=True))
    assert all("equal_pressure" in one.flags for one in result.predictions)
    pdc = np.array([reading(one)["PDC"] for one in result.predictions])
    shares = ((pdc - (2500.0, 1600.0)) / (900.0, 700.0)).mean(axis=1)
    assert result.costs[0] == pytest.approx(shares.min())
    assert sorted(planner.feedback[0].costs) == pytest.approx(sorted(shares))  # as they are predicted
    request = planner.request(5)
    asked = planner.ask(request).predictions
    assert all("equal_pressure" in one.flags for one in asked)
    contacts = np.array([[*one.g1, *one.g2] for one in planner.grasps[:5]]).ravel()
    batch = planner.ask(PredictTouch.Request(cloud=request.cloud, table=request.table, contacts=contacts), "batch")
    assert np.reshape(batch.flagged, (5, -1))[:, batch.flags.index("equal_pressure")].all()
    assert "equal_pressure" not in planner.ask(planner.request(1)).predictions[0].flags


def test_a_goal_that_cannot_be_met_and_too_many_grasps_are_refused_with_the_reason(graph, planner):
    graph.set(planner.node, max_grasps=5)
    for spoil, status, reason in (
        ({"cost": "beauty"}, Status.BAD_REQUEST, "'beauty' is not one of pressure, score"),
        ({"table": []}, Status.BAD_PLANE, "needed with a cloud"),
        ({"cloud": PointCloud2()}, Status.EMPTY_CLOUD, "no object_cloud with a table"),
        ({"count": 6}, Status.BAD_REQUEST, "bad_request: count: 6 is above max_grasps, 5"),
    ):
        goal = planner.goal()
        for name, value in spoil.items():
            setattr(goal, name, value)
        result = planner.sample(goal)
        assert (result.status, list(result.costs)) == (status, [])
        assert reason in result.grasp_state
    answer = planner.ask(planner.request(6))
    assert (answer.status, answer.reason) == (Status.BAD_REQUEST, "grasps: 6 is above max_grasps, 5")
    assert planner.ask(planner.request(5)).status == Status.OK


def test_an_internal_error_is_a_status_and_configuring_again_restores_service_and_action(graph, planner, monkeypatch):
    assert planner.ask().status == Status.OK
    assert graph.change("touch_predictor", "deactivate", "cleanup")
    graph.until(lambda: not graph.probe.count_services("/foretouch/predict_touch"))
    assert graph.change("touch_predictor", "configure", "activate")
    assert planner.ask().status == Status.OK
    assert planner.sample().grasp_state == "success"

    def fail(*_, **__):
        raise FloatingPointError("overflow")

    with monkeypatch.context() as patch:
        patch.setattr(type(planner.node._predictor), "array", fail)
        answer = planner.ask()
        assert (answer.status, answer.reason) == (Status.FAILED, "FloatingPointError: overflow")
        assert answer.header.frame_id == "cam"
        result = planner.sample()
        assert (result.status, result.grasp_state) == (Status.FAILED, "failed: FloatingPointError: overflow")
    assert planner.node.internal_errors.counts() == {"predict_touch": 1, "sample_grasps": 1}
    assert planner.ask().status == Status.OK


def test_reach_and_limits_of_objects_are_those_of_the_parameters(graph, tmp_path, target, grasps):
    planner = Planner(graph, target, grasps, model=save_calibrated_network(tmp_path))
    config, default = planner.node.config, PipelineConfig()
    assert (config.max_width_m, config.max_distance_m) == (default.reach.max_width_m, default.reach.max_distance_m)
    assert config.limits == default.limits
    graph.set(planner.node, max_width_m=0.4, max_distance_m=0.5)
    request = planner.request(3)
    first, second, _ = request.grasps
    first.g1.x, second.g1.x = first.g2.x + 0.35, second.g2.x + 0.45
    without_orientation(first)
    without_orientation(second)
    wide, wider, fine = planner.ask(request).predictions
    assert (wide.status, wider.status, fine.status) == (Status.OK, Status.BAD_GRASP, Status.OK), wide.reason
    assert "m apart, more than max_width_m 0.4" in wider.reason
    graph.set(planner.node, max_width_m=0.3)
    assert "more than max_width_m 0.3" in planner.ask(request).predictions[0].reason

    graph.set(planner.node, limits__max_extent_m=0.03)
    answer = planner.ask(planner.request(2))
    assert (answer.status, len(answer.predictions)) == (Status.BAD_CLOUD, 2)
    assert "more than max_extent_m 0.03" in answer.reason
    result = planner.sample()
    assert (result.status, "more than max_extent_m 0.03" in result.grasp_state) == (Status.NO_GRASP, True)
    graph.set(planner.node, limits__max_extent_m=5.0, max_distance_m=5.0)
    request = planner.request()
    points = np.concatenate([target.cloud.xyz, target.cloud.xyz + np.float32([2.0, 0.0, 0.0])])
    request.cloud = cloud_to_msg(Cloud(points, frame_id="cam"))
    assert planner.ask(request).status == Status.OK


def test_a_cancel_takes_effect_within_a_hundred_grasps(graph, planner, monkeypatch):
    real, sizes, handles = type(planner.node._predictor).array, [], []

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
    monkeypatch.setattr(type(planner.node._predictor), "array", slow)
    sent = graph.action_client(SampleGrasps, "sample_grasps").send_goal_async(planner.goal())
    sent.add_done_callback(lambda future: handles.append(future.result()))
    graph.until(lambda: handles)
    future = handles[0].get_result_async()
    graph.until(future.done)
    assert sizes == [100, 100]
    assert future.result().status == GoalStatus.STATUS_CANCELED
    assert len(future.result().result.grasps) == 200


def test_a_model_of_the_simulated_hand_warns_of_readings_that_come_from_another(graph, monkeypatch):
    (node,) = graph.add("touch_predictor", tactile_topic="/other/tactile")
    assert node.warnings() == ()
    sender = graph.talk(BiotacAll, "/other/tactile")
    graph.until(lambda: node.get_publishers_info_by_topic("/other/tactile"))
    assert node.warnings() == ()  # the default model is not made for one hand only
    monkeypatch.setattr(type(node._predictor.model), "simulated", True)
    (line,) = node.warnings()
    model = node._predictor.model.name
    assert line.startswith(f"model {model} is made for the simulated hand only, but /other/tactile comes from ")
    del sender


def test_a_request_that_has_waited_for_too_long_is_refused_and_counted(planner, monkeypatch):
    monkeypatch.setattr("foretouch.ros.runtime.workers.PATIENCE_S", -1.0)
    answer = planner.ask()
    assert (answer.status, answer.reason.partition(" behind")[0]) == (Status.BUSY, "busy: waited for -1 s")
    assert planner.node.notes()["requests.predict_touch.busy"] == "1"


def test_each_of_many_requests_and_goals_at_once_is_answered_or_refused_and_counted(planner):
    """More than any queue of rclpy's own depth, 10, would keep."""
    graph, asked = planner.graph, {"predict_touch": 80, "sample_grasps": 40}
    client = graph.probe.create_client(PredictTouch, "predict_touch", qos_profile=REQUESTS)
    assert client.wait_for_service(10.0)
    answers = [client.call_async(planner.request()) for _ in range(asked["predict_touch"])]
    graph.until(lambda: all(one.done() for one in answers))
    touches = [one.result().touch for one in answers]
    assert all(bool(touch.predictions) is (touch.reason == "") for touch in touches)
    assert all(touch.reason.startswith("busy: ") for touch in touches if touch.reason)
    actions = graph.action_client(
        SampleGrasps, "sample_grasps", goal_service_qos_profile=REQUESTS, result_service_qos_profile=REQUESTS
    )
    sent = [actions.send_goal_async(planner.goal()) for _ in range(asked["sample_grasps"])]
    graph.until(lambda: all(one.done() for one in sent))
    ends = [one.result().get_result_async() for one in sent]
    graph.until(lambda: all(one.done() for one in ends))
    assert {one.result().status for one in ends} <= {GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED}
    counts = Counter()
    for name, count in planner.node.notes().items():
        if name.startswith("requests."):
            counts[name.split(".")[1]] += int(count)
    assert counts == asked
