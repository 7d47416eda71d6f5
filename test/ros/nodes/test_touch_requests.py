# SPDX-License-Identifier: Apache-2.0
"""Requests and goals to one running touch predictor: what is answered, and what is refused with which reason."""

import math
from dataclasses import replace

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from every_case import every_case
from geometry_msgs.msg import Point, Quaternion
from planner_builders import Planner, a_target, many_grasps, oriented, without_orientation
from sensor_msgs.msg import PointCloud2

from foretouch import reading
from foretouch.grasp import GeoGraspConfig
from foretouch.models import load_model
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.stream import named
from foretouch.types import Cloud, Grasps
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, Status
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def planner(module_graph, scene_cloud, model_card):
    target = a_target(scene_cloud)
    return Planner(module_graph, target, many_grasps(target), model=model_card)


def test_grasps_are_answered_in_order_with_the_models_numbers_and_posed_if_need_be(planner, model_card):
    answer = planner.ask(planner.request(10))
    expected = load_model(model_card).predict(planner.target.cloud, planner.grasps)
    assert len(answer.predictions) == len(planner.grasps) > 1
    assert answer.header.frame_id == "cam"
    for message, prediction in zip(answer.predictions, expected, strict=True):
        assert message.status == Status.OK
        assert reading(message)["PDC"].value[0] == np.float32(prediction.value["PDC_TH"][0])
        np.testing.assert_array_equal(
            reading(message)["E"].value[1].tolist(), prediction.value["E_MF"].astype(np.float32)
        )
    request = planner.request()
    without_orientation(request.grasps[0])
    (posed,) = planner.ask(request).predictions
    grasp = Pipeline().grasp_between(planner.target, planner.grasps[0].g1, planner.grasps[0].g2)
    (expected,) = load_model(model_card).predict(planner.target.cloud, [grasp])
    assert reading(posed)["PDC"].value[1] == np.float32(expected.value["PDC_MF"][0])
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
        ("grasps: is empty: send grasps, or contacts", Status.BAD_REQUEST, lambda r: setattr(r, "grasps", [])),
        ("row_step", Status.BAD_CLOUD, lambda r: setattr(r.cloud, "row_step", 1)),
        ("finite", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", np.full(4, math.nan))),
        ("holds no plane", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", np.zeros(4))),
        ("farther away than 1000 m", Status.BAD_PLANE, lambda r: setattr(r.table[0], "coef", [0.0, 0.0, 1.0, 1e20])),
        ("is not 1", Status.BAD_GRASP, lambda r: setattr(r.grasps[0].pose.orientation, "x", 1e160)),
        (
            "degrees from g1 - g2, more than 30",
            Status.BAD_GRASP,
            lambda r: oriented(r.grasps[0], Quaternion(x=1.0, w=0.0)),
        ),
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
        assert math.isnan(reading(answer.predictions[1])["PDC"].value[0])


def arrays_of(request, *, oriented=True):
    """The same request with arrays."""
    contacts = [value for grasp in request.grasps for p in (grasp.g1, grasp.g2) for value in (p.x, p.y, p.z)]
    turned = np.concatenate([grasp.rotation for grasp in request.grasps]) if oriented else []
    return PredictTouch.Request(cloud=request.cloud, table=request.table, contacts=contacts, rotations=turned)


def test_arrays_are_answered_with_the_numbers_of_messages_and_with_the_orientations_that_were_computed(planner):
    asked = planner.request(10)
    asked.grasps[2].g1.x += 1.0  # too wide
    for turned in (True, False):
        if not turned:
            for grasp in asked.grasps:
                without_orientation(grasp)
        messages, batch = planner.ask(asked).predictions, planner.ask(arrays_of(asked, oriented=turned), "batch")
        found = reading(batch)
        assert batch.header == messages[0].header
        for k, message in enumerate(messages):
            assert (batch.statuses[k], batch.reasons[k]) == (message.status, message.reason)
            for name in (*message.scalar_channels, *message.channels):
                for many, one in zip(found[name], reading(message)[name], strict=True):
                    np.testing.assert_array_equal(many[k], one)
            names = [
                name
                for name, has in zip(batch.flags, np.reshape(batch.flagged, (len(messages), -1))[k], strict=True)
                if has
            ]
            own = set(message.grasp.flags)  # of the planner, which arrays do not bring
            assert sorted(names) == sorted(set(message.flags) - own)
        rotations = np.reshape(batch.rotations, (-1, 9))
        assert len(rotations) == (0 if turned else len(messages))
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
        ("contacts: grasps are given too", Status.BAD_REQUEST, lambda r: setattr(r, "grasps", [Grasp()])),
        ("'77' is not one of", Status.BAD_GRASP, lambda r: setattr(r, "object_id", "77")),
        ("is not a rotation", Status.BAD_GRASP, lambda r: setattr(r, "rotations", [0.5] * 9)),
        ("is not finite", Status.BAD_GRASP, lambda r: setattr(r, "contacts", [math.nan] * 6)),
        (
            "no object_cloud with a table was received yet",
            Status.EMPTY_CLOUD,
            lambda r: setattr(r, "cloud", PointCloud2()),
        ),
        ("", Status.OK, lambda _: None),
    ]
    every_case(cases, check)
    assert not planner.node.internal_errors.counts()


def test_sampled_grasps_come_cheapest_first_and_match_their_poses(planner):
    result = planner.sample()
    assert result.grasp_state == "success"
    assert len(result.costs) == len(result.grasps) == len(result.grasp_candidates) == len(result.predictions) == 5
    assert list(result.costs) == sorted(result.costs)
    for pose, grasp in zip(result.grasp_candidates, result.grasps, strict=True):
        assert (pose.pose, pose.header.frame_id) == (grasp.pose, "cam")
    first = result.predictions[0]
    share = ((reading(first)["PDC"].value[0] - 2500) / 900 + (reading(first)["PDC"].value[1] - 1600) / 700) / 2
    assert result.costs[0] == pytest.approx(share, rel=1e-5)
    assert sorted(planner.feedback[0].costs) == list(result.costs)
    assert not any(
        "equal_pressure" in prediction.flags for prediction in result.predictions
    )  # this model has no intervals
    by_score = planner.sample(planner.goal(cost=SampleGrasps.Goal.SCORE))
    plan = Pipeline(PipelineConfig(grasp=GeoGraspConfig(count=5))).plan(planner.target)
    np.testing.assert_allclose(by_score.costs, [-grasp.score for grasp in plan.grasps], rtol=1e-6)


def test_a_cancel_takes_effect_within_a_hundred_grasps(planner, monkeypatch):
    graph, step, sizes, handles = planner.graph, planner.node._step, [], []
    real = step.answer_plans

    def many(plan, target, name):
        return named(
            replace(plan, grasps=Grasps.of([grasp for grasp in plan.grasps for _ in range(1000)])), target, name
        )

    def slow(targets, plans, grasps):
        sizes.append(len(grasps.grasps))
        if len(sizes) == 2:
            cancelled = handles[0].cancel_goal_async()
            graph.until(cancelled.done)
        return real(targets, plans, grasps)

    monkeypatch.setattr("foretouch.ros.steps.sampling.named", many)
    monkeypatch.setattr(step, "answer_plans", slow)
    sent = graph.action_client(SampleGrasps, "sample_grasps").send_goal_async(planner.goal())
    sent.add_done_callback(lambda future: handles.append(future.result()))
    graph.until(lambda: handles)
    future = handles[0].get_result_async()
    graph.until(future.done)
    assert sizes == [100, 100]
    assert future.result().status == GoalStatus.STATUS_CANCELED
    assert len(future.result().result.grasps) == 200
