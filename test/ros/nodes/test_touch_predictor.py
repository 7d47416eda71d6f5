# SPDX-License-Identifier: Apache-2.0
"""The service, the action, and a model that cannot be loaded."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from planner_builders import Planner, a_target, many_grasps
from sensor_msgs.msg import PointCloud2

from foretouch import reading
from foretouch.ros.runtime.lifecycle_node import REQUESTS
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import BiotacAll, Status
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def target(scene_cloud):
    return a_target(scene_cloud)


@pytest.fixture(scope="module")
def grasps(target):
    return many_grasps(target)


@pytest.fixture
def planner(graph, target, grasps, model_card):
    return Planner(graph, target, grasps, model=model_card)


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


def test_costs_within_the_interval_of_the_lowest_are_equal_and_ordered_by_score(graph, target, grasps):
    planner = Planner(graph, target, grasps, model="default")
    result = planner.sample()
    scores = [grasp.score for grasp in result.grasps]
    assert (len(set(result.costs)), scores) == (1, sorted(scores, reverse=True))
    assert all("equal_pressure" in prediction.flags for prediction in result.predictions)
    pdc = np.array([reading(prediction)["PDC"].value for prediction in result.predictions])
    shares = ((pdc - (2500.0, 1600.0)) / (900.0, 700.0)).mean(axis=1)
    assert result.costs[0] == pytest.approx(shares.min())
    assert sorted(planner.feedback[0].costs) == pytest.approx(sorted(shares))  # as they are predicted
    request = planner.request(5)
    asked = planner.ask(request).predictions
    assert all("equal_pressure" in one.flags for one in asked)
    contacts = np.array([[*grasp.g1, *grasp.g2] for grasp in planner.grasps[:5]]).ravel()
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
        patch.setattr(type(planner.node._step.predictor), "predict", fail)
        answer = planner.ask()
        assert (answer.status, answer.reason) == (Status.FAILED, "FloatingPointError: overflow")
        assert answer.header.frame_id == "cam"
        result = planner.sample()
        assert (result.status, result.grasp_state) == (Status.FAILED, "failed: FloatingPointError: overflow")
    assert planner.node.internal_errors.counts() == {"predict_touch": 1, "sample_grasps": 1}
    assert planner.ask().status == Status.OK


def test_a_model_of_the_simulated_hand_warns_of_readings_that_come_from_another(graph, monkeypatch):
    (node,) = graph.add("touch_predictor", tactile_topic="/other/tactile")
    assert node.reported().warnings == []
    sender = graph.talk(BiotacAll, "/other/tactile")
    graph.until(lambda: node.get_publishers_info_by_topic("/other/tactile"))
    assert node.reported().warnings == []  # the default model is not made for one hand only
    monkeypatch.setattr(type(node._step.predictor.model), "simulated", True)
    (line,) = node.reported().warnings
    model = node._step.predictor.model.name
    assert line.startswith(f"model {model} is made for the simulated hand only, but /other/tactile comes from ")
    del sender


def test_each_of_many_requests_and_goals_at_once_is_answered_or_refused_and_counted(planner):
    """More than any queue of rclpy's own depth, 10, would keep."""
    graph, asked = planner.graph, {"predict_touch": 80, "sample_grasps": 40}
    client = graph.probe.create_client(PredictTouch, "predict_touch", qos_profile=REQUESTS)
    assert client.wait_for_service(10.0)
    answers = [client.call_async(planner.request()) for _ in range(asked["predict_touch"])]
    graph.until(lambda: all(answer.done() for answer in answers))
    touches = [answer.result().touch for answer in answers]
    assert all(bool(touch.predictions) is (touch.reason == "") for touch in touches)
    assert all(touch.reason.startswith("busy: ") for touch in touches if touch.reason)
    actions = graph.action_client(
        SampleGrasps, "sample_grasps", goal_service_qos_profile=REQUESTS, result_service_qos_profile=REQUESTS
    )
    sent = [actions.send_goal_async(planner.goal()) for _ in range(asked["sample_grasps"])]
    graph.until(lambda: all(one.done() for one in sent))
    ends = [one.result().get_result_async() for one in sent]
    graph.until(lambda: all(end.done() for end in ends))
    assert {end.result().status for end in ends} <= {GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED}
    counts = Counter()
    for name, count in planner.node.reported().values.items():
        if name.startswith("requests."):
            counts[name.split(".")[1]] += int(count)
    assert counts == asked
