# SPDX-License-Identifier: Apache-2.0
"""A predictor of the user in the graph: served with intervals and adaptation, and whatever it does, the graph goes on."""

import threading
import time

import numpy as np
import own_predictors
import pytest
from experiment_samples import make_samples

import foretouch as ft
from foretouch.ros.runtime import processing_node
from foretouch_msgs.msg import Status

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("own")
    ft.calibrate(own_predictors.Bad(), make_samples(8, 5), name="bad").save(folder / "bad")
    return str(folder / "bad")


def test_a_predictor_of_the_user_is_served_and_its_faults_are_answers(graph, predictor, saved, monkeypatch) -> None:
    node, send, heard = predictor(model=saved, predictor="own_predictors:Bad", late_after_s=1.0)
    expected = [
        ("", Status.OK, ""),
        (
            "shape",
            Status.REFUSED,
            "bad: estimate: returned counts of shape (1, 7); 1 grasps and 50 values need (1, 50)",
        ),
        ("nan", Status.REFUSED, "the model gives a value that is not finite"),
        ("error", Status.REFUSED, "bad: estimate: ZeroDivisionError: division by zero (own_predictors.py:"),
        ("exit", Status.REFUSED, "bad: estimate: SystemExit: 3 (own_predictors.py:"),
        ("", Status.OK, ""),
    ]
    for number, (fault, status, reason) in enumerate(expected, 1):
        monkeypatch.setattr(own_predictors.Bad, "fault", fault)
        send(time.time_ns())
        graph.until(lambda count=number: len(heard) == count)
        (one,) = heard[-1].predictions
        assert (one.status, one.reason.startswith(reason)) == (status, True), one.reason
        assert one.model == "bad"
    reading = ft.reading(one)
    assert np.isfinite(reading["E"].lower).all()
    assert np.isfinite(reading["PDC"].upper).all()
    assert not node.reported().errors
    assert "regime" in node.reported().values  # it adapts to readings


def test_a_slow_predictor_is_flagged_late_and_clouds_that_it_misses_are_counted(
    graph, predictor, saved, monkeypatch
) -> None:
    node, send, heard = predictor(model=saved, predictor="own_predictors:Bad", late_after_s=1.0)
    monkeypatch.setattr(own_predictors.Bad, "fault", "slow")
    first = time.time_ns()
    for number in range(4):
        send(first + number)
        time.sleep(0.1)
    graph.until(lambda: len(heard) >= 2)
    assert {flag for answer in heard for one in answer.predictions for flag in one.flags} >= {"late"}
    graph.until(lambda: node.statistics.summary().received == 4)
    now = node.statistics.summary()
    assert (now.used + now.dropped["superseded"], now.dropped["superseded"]) == (4, 2)
    assert all(answer.predictions[0].status == Status.OK for answer in heard)


def test_a_predictor_that_takes_minutes_is_reported_and_the_node_stops_without_it(
    graph, predictor, saved, monkeypatch
) -> None:
    node, send, heard = predictor(model=saved, predictor="own_predictors:Bad")
    monkeypatch.setattr(processing_node, "_PATIENCE_S", 0.2)
    monkeypatch.setattr(own_predictors.Bad, "fault", "minutes")
    monkeypatch.setattr(own_predictors.Bad, "end", threading.Event())
    send(time.time_ns())
    graph.until(lambda: any(line.startswith("no answer for ") for line in node.reported().warnings))
    node.trigger_deactivate()
    assert node.state_name == "inactive"
    monkeypatch.setattr(own_predictors.Bad, "fault", "")
    node.trigger_activate()
    send(time.time_ns())
    graph.until(lambda: heard)
    own_predictors.Bad.end.set()  # its answer is dropped
    graph.until(lambda: node.statistics.summary().dropped == {"stopped": 1})
    assert [answer.predictions[0].status for answer in heard] == [Status.OK]
    assert not node.reported().warnings


def test_without_its_predictor_the_model_is_named_in_every_answer(graph, predictor, saved) -> None:
    node, send, heard = predictor(model=saved)
    send(time.time_ns())
    graph.until(lambda: heard)
    (one,) = heard[0].predictions
    assert one.status == Status.NO_MODEL
    assert "is made of own_predictors:Bad, and no card makes foretouch import code" in one.reason
    assert "--predictor own_predictors:Bad" in node.reported().errors[0]
