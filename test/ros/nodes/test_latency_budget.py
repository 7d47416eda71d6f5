# SPDX-License-Identifier: Apache-2.0
"""A running node with a latency budget: what it chooses, flags and reports."""

import time

import numpy as np
import pytest

from foretouch import reading
from foretouch.models import budget as budgets
from foretouch.models import load_model
from foretouch.models.budget import levels_of, profile_scene
from foretouch.pipeline import Object
from foretouch.ros.messages import answers
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.types import ASSUMED_TABLE
from foretouch_msgs.msg import Status
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def profile(monkeypatch):
    """A profile that needs no measurement: a level takes 3 ms for each of those after it."""

    def measured(levels):
        return {one.name: dict.fromkeys((1, 1000), 0.003 * (len(levels) - k)) for k, one in enumerate(levels)}

    monkeypatch.setattr(budgets, "_measure", measured)


def request(count=1):
    cloud, grasps = profile_scene(count)
    message = objects_to_msg([Object("1", cloud, ASSUMED_TABLE)], "cam", 5)
    return PredictTouch.Request(cloud=message, grasps=[grasp_to_msg(one) for one in grasps])


def ask(graph, count=1):
    return graph.call(PredictTouch, "predict_touch", request(count)).touch


def delayed(monkeypatch, owner, name, seconds):
    original = getattr(owner, name)

    def slowly(*args, **kwargs):
        time.sleep(seconds)
        return original(*args, **kwargs)

    monkeypatch.setattr(owner, name, slowly)


def test_a_wide_budget_gets_the_model_itself_and_a_narrow_one_a_flagged_mean(graph):
    cloud, grasps = profile_scene(1)
    levels = levels_of(load_model())
    for budget_ms, level, reduced in ((0.0, levels[0], False), (10_000.0, levels[0], False), (4.0, levels[-1], True)):
        (node,) = graph.add("touch_predictor", latency_budget_ms=budget_ms, late_after_s=0.0)
        message = ask(graph)
        assert message.status == Status.OK
        (prediction,), (expected,) = message.predictions, level.model.predict(cloud, grasps)
        assert reading(prediction)["PDC"].value[0] == pytest.approx(expected.value["PDC_TH"][0], rel=1e-6)
        assert reading(prediction)["PDC"].lower[0] == pytest.approx(expected.lower["PDC_TH"][0], rel=1e-6)
        assert ("reduced" in prediction.flags) == reduced
        assert node.notes().get("budget.level") == (level.name if budget_ms else None)
        graph.remove(node)


def test_an_answer_that_becomes_late_while_it_is_made_is_flagged_as_messages_and_as_arrays(
    graph, predictor, monkeypatch
):
    node, send, heard = predictor(late_after_s=0.0, latency_budget_ms=300.0)
    delayed(monkeypatch, answers, "_adapted", 0.35)
    assert [one.flags.count("late") for one in ask(graph, 2).predictions] == [1, 1]
    assert node.notes()["budget.late"] == "1"
    asked = request(2)
    contacts = [value for one in asked.grasps for p in (one.g1, one.g2) for value in (p.x, p.y, p.z)]
    turned = np.concatenate([one.rotation for one in asked.grasps])
    asked = PredictTouch.Request(cloud=asked.cloud, contacts=contacts, rotations=turned)
    batch = graph.call(PredictTouch, "predict_touch", asked).batch
    assert (list(batch.statuses), batch.flags.count("late")) == ([Status.OK] * 2, 1)
    assert np.reshape(batch.flagged, (2, -1))[:, batch.flags.index("late")].all()
    send(5)
    graph.until(lambda: heard)
    assert "late" in heard[0].predictions[0].flags
    assert node.notes()["budget.late"] == "3"
