# SPDX-License-Identifier: Apache-2.0
"""A running node with a latency budget: what it chooses, flags and reports."""

import sys
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2

from foretouch.models import budget as budgets
from foretouch.models import load_model
from foretouch.models.budget import levels_of, profile_scene
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.types import ASSUMED_TABLE
from foretouch_msgs.msg import GraspArray, Status, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def profile(monkeypatch, tmp_path):
    """A profile that needs no measurement: a level takes 3 ms for each of those after it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def measured(levels, seconds, progress):
        return {one.name: dict.fromkeys((1, 1000), 0.003 * (len(levels) - k)) for k, one in enumerate(levels)}, "idle"

    monkeypatch.setattr(budgets, "_measure", measured)


def request(count=1):
    cloud, grasps = profile_scene(count)
    target = FoundObject("1", cloud, ASSUMED_TABLE)
    return PredictTouch.Request(cloud=objects_to_msg([target], "cam", 5), grasps=[grasp_to_msg(one) for one in grasps])


def test_without_a_budget_nothing_changes(graph):
    (node,) = graph.add("touch_predictor")
    message = graph.call(PredictTouch, "predict_touch", request()).touch
    cloud, grasps = profile_scene(1)
    expected = load_model().predict(cloud, grasps)[0].value
    assert message.predictions[0].pdc_th.value == pytest.approx(expected.pdc_th, rel=1e-6)
    assert not {"reduced", "late"} & set(message.predictions[0].flags) - {"late"}  # the stamp is long past
    assert "budget_ms" not in node.notes()


def test_a_wide_budget_gets_the_model_itself_and_a_narrow_one_a_flagged_mean(graph):
    cloud, grasps = profile_scene(1)
    levels = levels_of(load_model())
    for budget_ms, level, reduced in ((10_000.0, levels[0], False), (4.0, levels[-1], True)):
        (node,) = graph.add("touch_predictor", latency_budget_ms=budget_ms, late_after_s=0.0)
        message = graph.call(PredictTouch, "predict_touch", request()).touch
        assert message.status == Status.OK
        (prediction,) = message.predictions
        expected = level.model.predict(cloud, grasps)[0]
        assert prediction.pdc_th.value == pytest.approx(expected.value.pdc_th, rel=1e-6)
        assert prediction.pdc_th.lower == pytest.approx(expected.lower.pdc_th, rel=1e-6)
        assert ("reduced" in prediction.flags) == reduced
        assert node.notes()["budget.level"] == level.name
        node.destroy_node()
        graph.nodes.remove(node)


def test_waiting_in_the_queue_counts_and_late_answers_are_flagged(graph, monkeypatch):
    (node,) = graph.add("touch_predictor", latency_budget_ms=60.0, late_after_s=0.0, diagnostics_period_s=0.1)
    heard = graph.listen(TouchPredictionArray, "touch")
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
    for topic in ("object_cloud", "grasps", "touch"):
        graph.matched(topic)
    original = type(node._predictor).array

    def slowly(self, *args, **kwargs):
        time.sleep(0.1)
        return original(self, *args, **kwargs)

    monkeypatch.setattr(type(node._predictor), "array", slowly)
    for stamp in (1, 2, 3):
        message = request()
        message.cloud.header = header_to_msg("cam", stamp)
        clouds.publish(message.cloud)
        grasps.publish(GraspArray(header=message.cloud.header, grasps=message.grasps))
    graph.until(lambda: len(heard) == 3)
    assert all("late" in one.predictions[0].flags for one in heard)
    assert "reduced" not in heard[0].predictions[0].flags
    assert "reduced" in heard[2].predictions[0].flags  # it waited for 0.2 s
    graph.until(lambda: any(v.key == "budget.late" and v.value == "3" for r in reports for v in r.status[0].values))


def test_a_budget_that_nothing_meets_is_used_and_said(graph):
    before = sys.getswitchinterval()
    (node,) = graph.add("touch_predictor", latency_budget_ms=0.01, late_after_s=0.0)
    assert sys.getswitchinterval() <= 0.0005  # another thread must not hold up an answer for a whole budget
    message = graph.call(PredictTouch, "predict_touch", request(3)).touch
    assert [one.flags[-2:] for one in message.predictions] == [["reduced", "late"]] * 3
    assert node.notes()["budget.unaffordable"] == "1"
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert sys.getswitchinterval() == before


def test_an_answer_of_the_service_that_becomes_late_while_it_is_made_says_so(graph, monkeypatch):
    (node,) = graph.add("touch_predictor", latency_budget_ms=1000.0, late_after_s=0.0)
    original = TouchAnswer.prediction

    def slowly(self, k):
        time.sleep(0.6)
        return original(self, k)

    monkeypatch.setattr(TouchAnswer, "prediction", slowly)
    message = graph.call(PredictTouch, "predict_touch", request(2)).touch
    assert [one.flags.count("late") for one in message.predictions] == [1, 1]
    assert node.notes()["budget.late"] == "1"


def test_an_answer_that_becomes_late_while_it_is_encoded_says_so(graph, monkeypatch):
    (node,) = graph.add("touch_predictor", latency_budget_ms=1000.0, late_after_s=0.0)
    heard = graph.listen(TouchPredictionArray, "touch")
    clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
    for topic in ("object_cloud", "grasps", "touch"):
        graph.matched(topic)
    original = TouchAnswer.encoded

    def slowly(self):
        time.sleep(1.1)
        return original(self)

    monkeypatch.setattr(TouchAnswer, "encoded", slowly)
    message = request()
    clouds.publish(message.cloud)
    grasps.publish(GraspArray(header=message.cloud.header, grasps=message.grasps))
    graph.until(lambda: heard)
    assert "late" in heard[0].predictions[0].flags
    assert node.notes()["budget.late"] == "1"
