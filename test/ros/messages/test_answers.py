# SPDX-License-Identifier: Apache-2.0
"""Encoded answers equal the messages that rclpy sends, in every field."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from foretouch.grasp.pose import hand_rotation
from foretouch.ros.messages.answers import Refusal, TouchAnswer, middleware_reads_cdr
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.types import Evidence, Grasp, Touch, TouchPrediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = pytest.mark.ros


def prediction(rng: np.random.Generator, grasp: Grasp) -> TouchPrediction:
    value, low, high = (Touch.from_vector(rng.normal(2000.0, 1e3, 50)) for _ in range(3))
    bounded = rng.random() < 0.7
    flags = tuple(rng.choice(["out_of_range", "unfamiliar", "é"], rng.integers(0, 3), replace=False).tolist())
    evidence = Evidence(int(rng.integers(9)), rng.choice([None, 1.25]), int(rng.integers(9)), rng.choice([None, 7.5]))
    reference = rng.choice(["none", "tare", "touches", "history"]).item()
    return TouchPrediction(
        grasp, value, low if bounded else None, high if bounded else None, reference, flags, evidence=evidence
    )


def answer(seed: int, count: int) -> TouchAnswer:
    """Random strings, so that every alignment occurs."""
    rng = np.random.default_rng(seed)
    text = lambda: "x" * int(rng.integers(0, 12))  # noqa: E731
    grasps, outcomes = [], []
    for _ in range(count):
        g1, g2 = rng.normal(size=3), rng.normal(size=3)
        grasp = Grasp(
            g1, g2, hand_rotation(g1, g2, np.array([1.0, 0.0, 0.0])), rng.choice([0.3, math.nan]), text(), text()
        )
        grasps.append(grasp_to_msg(grasp, int(rng.integers(3)), text()))
        refused = rng.random() < 0.2
        outcomes.append(Refusal(Status.BAD_GRASP, text()) if refused else prediction(rng, grasp))
    flags = tuple("late" for _ in range(int(rng.integers(0, 3))))
    return TouchAnswer(
        header_to_msg(text(), 5_000_000_123), grasps, outcomes, flags, Duration(sec=-1, nanosec=7), text(), text()
    )


def content(message: TouchPredictionArray) -> str:
    with np.printoptions(floatmode="unique", threshold=10**9):
        return str(message)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_the_bytes_are_those_of_the_message(seed, count):
    one = answer(seed, count)
    data, expected = one.encoded(), serialize_message(one.message)
    assert len(data) == len(expected)
    assert content(deserialize_message(data, TouchPredictionArray)) == content(
        deserialize_message(expected, TouchPredictionArray)
    )
    one.flags += ("late",)  # as at the end of its budget
    assert content(deserialize_message(one.encoded(), TouchPredictionArray)) == content(
        deserialize_message(serialize_message(one.message), TouchPredictionArray)
    )


def test_this_middleware_reads_them():
    assert middleware_reads_cdr()


def test_values_beyond_single_precision_and_texts_with_a_zero_are_sent_as_rclpy_does():
    grasp = Grasp(np.zeros(3), np.ones(3), np.eye(3))
    touch = Touch.from_vector(np.full(50, 1e300))
    one = TouchAnswer(Header(frame_id="a\0b"), [GraspMsg(id="c\0d")], [TouchPrediction(grasp, touch)])
    assert content(deserialize_message(one.encoded(), TouchPredictionArray)) == content(
        deserialize_message(serialize_message(one.message), TouchPredictionArray)
    )


def test_the_status_is_that_of_any_prediction_else_of_the_first_refusal():
    one = answer(0, 3)
    refused = [Refusal(Status.BAD_GRASP, "a"), Refusal(Status.REFUSED, "b")]
    for outcomes, expected in ((refused, (Status.BAD_GRASP, "a")), ([], (Status.OK, ""))):
        made = TouchAnswer(one.header, one.grasps[: len(outcomes)], outcomes)
        assert (made.status, made.reason) == expected
    known = next(outcome for outcome in one.outcomes if not isinstance(outcome, Refusal))
    assert TouchAnswer(one.header, one.grasps, [*refused, known]).status == Status.OK


def test_an_answer_in_another_frame_keeps_all_but_header_and_grasps():
    one, other = answer(1, 3), answer(2, 3)
    before = one.encoded()
    moved = one.moved(other.header, other.grasps)
    message = deserialize_message(moved.encoded(), TouchPredictionArray)
    assert message.header == other.header
    assert [p.grasp.id for p in message.predictions] == [grasp.id for grasp in other.grasps]
    assert [list(p.flags) for p in message.predictions] == [list(p.flags) for p in one.message.predictions]
    assert one.encoded() == before
