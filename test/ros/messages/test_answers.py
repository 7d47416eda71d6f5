# SPDX-License-Identifier: Apache-2.0
"""Encoded answers equal the messages that rclpy sends, in every field."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from every_case import every_case
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from foretouch.grasp.pose import hand_rotation
from foretouch.ros.messages.answers import Refusal, TouchAnswer, middleware_reads_cdr
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.tactile import biotac_touch
from foretouch.types import Evidence, Grasp, TouchPrediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = pytest.mark.ros


def prediction(rng, grasp):
    value, low, high = (biotac_touch(rng.normal(2000.0, 1e3, 50)) for _ in range(3))
    flags = tuple(rng.choice(["out_of_range", "unfamiliar", "é"], rng.integers(0, 3), replace=False).tolist())
    evidence = Evidence(int(rng.integers(9)), rng.choice([None, 1.25]), int(rng.integers(9)), rng.choice([None, 7.5]))
    reference = rng.choice(["none", "tare", "touches", "history"]).item()
    bounds = (low, high) if rng.random() < 0.7 else (None, None)
    return TouchPrediction(grasp, value, *bounds, reference, flags, evidence=evidence)


def answer(seed, count):
    """Random strings, so that every alignment occurs."""
    rng = np.random.default_rng(seed)
    text = lambda: "x" * int(rng.integers(0, 12))  # noqa: E731
    grasps, outcomes = [], []
    for _ in range(count):
        g1, g2 = rng.normal(size=3), rng.normal(size=3)
        rotation = hand_rotation(g1, g2, np.array([1.0, 0.0, 0.0]))
        grasp = Grasp(g1, g2, rotation, rng.choice([0.3, math.nan]), text(), text())
        grasps.append(grasp_to_msg(grasp, int(rng.integers(3)), text()))
        refused = rng.random() < 0.2
        outcomes.append(Refusal(Status.BAD_GRASP, text()) if refused else prediction(rng, grasp))
    header, flags = header_to_msg(text(), 5_000_000_123), ("late",) * int(rng.integers(0, 3))
    return TouchAnswer(header, grasps, outcomes, flags, Duration(sec=-1, nanosec=7), text(), text())


def assert_sent_as_by_rclpy(one):
    data, expected = one.encoded(), serialize_message(one.message)
    assert len(data) == len(expected)
    with np.printoptions(floatmode="unique", threshold=10**9):
        found, wanted = (str(deserialize_message(each, TouchPredictionArray)) for each in (data, expected))
    assert found == wanted


def test_the_bytes_are_those_of_the_message_beyond_single_precision_and_with_a_zero_too():
    def check(seed, count):
        one = answer(seed, count)
        assert_sent_as_by_rclpy(one)
        one.flags += ("late",)  # as at the end of its budget
        assert_sent_as_by_rclpy(one)

    every_case([(seed, count) for seed in range(12) for count in (0, 1, 2, 7)], check)
    assert middleware_reads_cdr()
    touch = TouchPrediction(Grasp(np.zeros(3), np.ones(3), np.eye(3)), biotac_touch(np.full(50, 1e300)))
    one = TouchAnswer(Header(frame_id="a\0b"), [GraspMsg(id="c\0d")], [touch])
    assert_sent_as_by_rclpy(one)


def test_the_status_is_that_of_any_prediction_else_of_the_first_refusal():
    one = answer(0, 3)
    refused = [Refusal(Status.BAD_GRASP, "a"), Refusal(Status.REFUSED, "b")]
    for outcomes, expected in ((refused, (Status.BAD_GRASP, "a")), ([], (Status.OK, ""))):
        made = TouchAnswer(one.header, one.grasps[: len(outcomes)], outcomes)
        assert made.summary == expected
    known = next(outcome for outcome in one.outcomes if not isinstance(outcome, Refusal))
    assert TouchAnswer(one.header, one.grasps, [*refused, known]).summary == (Status.OK, "")
