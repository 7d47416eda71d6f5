# SPDX-License-Identifier: Apache-2.0
"""Answers as messages and as arrays: what is read from them is what was predicted, for every described sensor."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from constant_models import sensor_with_dead
from every_case import every_case
from rclpy.serialization import deserialize_message, serialize_message

import foretouch
from foretouch.errors import ModelError, TactileError
from foretouch.grasp.pose import hand_rotation
from foretouch.ros.messages.answers import Refusal, TouchAnswer
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, prediction_from_msg
from foretouch.tactile.description import packaged_sensor, sensor_files
from foretouch.types import Evidence, Grasp, Touch, TouchPrediction
from foretouch_msgs.msg import Status, TouchPredictionArray, TouchPredictionBatch

pytestmark = pytest.mark.ros

EVIDENCE = Evidence(2, 1.25, 7, 0.5)


def answer(sensor, count=5, **fields):
    """Predictions of random numbers, one of them refused and one without bounds."""
    rng = np.random.default_rng(count)
    grasps, outcomes = [], []
    for k in range(count):
        g1, g2 = rng.normal(size=(2, 3))
        grasp = Grasp(g1, g2, hand_rotation(g1, g2, np.array([1.0, 0.0, 0.0])), 0.3, f"g-{k}", "1")
        touches = [Touch(rng.normal(2000.0, 1e3, sensor.channels.size), sensor.channels) for _ in range(3)]
        ends = touches if k != 2 else [touches[0], None, None]
        flags = (("unfamiliar",), (), ("out_of_range", "unfamiliar"))[k % 3]
        grasps.append(grasp_to_msg(grasp))
        outcomes.append(TouchPrediction(grasp, *ends, "touches", flags, evidence=EVIDENCE))
    if count > 1:
        outcomes[1] = Refusal(Status.BAD_GRASP, "é")
    return TouchAnswer(
        header_to_msg("cam", 5), grasps, outcomes, ("late",), Duration(sec=1), "m", "s", sensor, **fields
    )


def sent(message):
    return deserialize_message(serialize_message(message), type(message))


def test_every_sensor_is_read_back_by_its_names_from_messages_and_from_arrays():
    def check(name):
        sensor = packaged_sensor(name)
        one = answer(sensor)
        message, batch = sent(one.message), sent(answer(sensor, arrays=True).batch)
        assert (type(message), type(batch)) == (TouchPredictionArray, TouchPredictionBatch)
        many = foretouch.reading(batch)
        for k, (outcome, found) in enumerate(zip(one.outcomes, message.predictions, strict=True)):
            read = foretouch.reading(found)
            assert list(read) == [channel.name for channel in sensor.channels.channels]
            assert (found.sensor, tuple(found.fingers), found.model) == (name, sensor.channels.fingers, "m")
            for key, values in read.items():
                for end in ("value", "lower", "upper"):
                    touch = None if isinstance(outcome, Refusal) else getattr(outcome, end)
                    array, stacked = (one if end == "value" else getattr(one, end) for one in (values, many[key]))
                    expected = [np.full(array.shape[1:], np.nan)] * len(sensor.channels.fingers)
                    if touch is not None:
                        parts = [touch[f"{key}_{finger}"] for finger in sensor.channels.fingers]
                        expected = [part if array.ndim == 2 else part[0] for part in parts]
                    np.testing.assert_array_equal(array, np.array(expected, np.float32))
                    np.testing.assert_array_equal(stacked[k], array)
            back = prediction_from_msg(found, sensor)
            if isinstance(outcome, Refusal):
                assert (back.value, back.status, back.reason) == (None, "bad_grasp", "é")
                assert batch.reasons[k] == "é"
            else:
                assert (back.reference, back.evidence, back.flags) == ("touches", EVIDENCE, (*outcome.flags, "late"))
                np.testing.assert_array_equal(back.value.values, outcome.value.values.astype(np.float32))
            flags = [flag for flag, has in zip(batch.flags, np.reshape(batch.flagged, (5, -1))[k], strict=True) if has]
            assert sorted(flags) == sorted(found.flags)
            assert batch.statuses[k] == found.status
        assert (batch.reference, batch.touches, batch.status, batch.input_age.sec) == (2, 2, Status.OK, 1)

    every_case([(name,) for name in sensor_files()], check)


def test_a_dead_taxel_is_marked_and_numbers_beyond_single_precision_become_infinite():
    sensor = sensor_with_dead("xela_uskin_4x4", 5)
    huge = Touch(np.full(96, 1e300), sensor.channels)
    one = answer(sensor, 1)
    message = TouchAnswer(one.header, one.grasps, [TouchPrediction(None, huge)], sensor=sensor).message.predictions[0]
    assert np.reshape(message.valid, (2, 16))[0].tolist() == [int(k != 5) for k in range(16)]
    assert np.isinf(message.values).all()


def test_a_reading_needs_no_ros_and_arrays_that_do_not_fit_are_refused():
    program = "import sys, foretouch; from types import SimpleNamespace as S; "
    program += (
        "m = S(fingers=['a', 'b'], channels=['E'], values=[1, 2, 3, 4], lower=[0] * 4, upper=[5] * 4, valid=[1] * 4, "
    )
    program += "scalar_channels=[], scalars=[], scalars_lower=[], scalars_upper=[]); r = foretouch.reading(m)['E']; "
    program += "assert r.tolist() == [[1, 2], [3, 4]] and r.upper.shape == (2, 2); assert 'rclpy' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
    message = answer(packaged_sensor("biotac_sp"), 1).message.predictions[0]
    fields = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    for name in ("values", "upper", "scalars_lower"):
        with pytest.raises(TactileError, match=f"{name}: 3 values are not 2 x"):
            foretouch.reading(SimpleNamespace(**{**fields, name: [1.0, 2.0, 3.0]}))
    with pytest.raises(ModelError, match=r"sensor: biotac_sp \(\w+\) is not xela_uskin_4x4"):
        prediction_from_msg(message, packaged_sensor("xela_uskin_4x4"))
    message.scalar_channels = ["P"]
    with pytest.raises(ModelError, match="channels: PDC of biotac_sp is missing"):
        prediction_from_msg(message)


def test_without_a_model_every_grasp_has_the_reason_and_no_numbers():
    grasps = answer(packaged_sensor("biotac_sp"), 2).grasps
    none = TouchAnswer(header_to_msg("cam", 5), grasps, [Refusal(Status.NO_MODEL, "absent")] * 2)
    message = sent(none.message)
    assert [(one.status, one.reason, len(one.values)) for one in message.predictions] == [
        (Status.NO_MODEL, "absent", 0)
    ] * 2
    assert (message.status, message.reason) == (Status.NO_MODEL, "absent")
    batch = sent(none.batch)
    assert (list(batch.statuses), batch.reasons, foretouch.reading(batch)) == (
        [Status.NO_MODEL] * 2,
        ["absent"] * 2,
        {},
    )
    assert prediction_from_msg(message.predictions[0]).value is None
