# SPDX-License-Identifier: Apache-2.0
"""Answers as messages and as arrays: what is read from them is what was predicted, for every described sensor."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from answer_builders import refusal
from builtin_interfaces.msg import Duration
from constant_models import sensor_with_dead
from every_case import every_case
from rclpy.serialization import deserialize_message, serialize_message

import foretouch
from foretouch.errors import ModelError, TactileError
from foretouch.grasp.messages import REFERENCES, STATUSES
from foretouch.grasp.pose import hand_rotation
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, prediction_from_msg
from foretouch.tactile.description import packaged_sensor, sensor_files
from foretouch.types import NO_GRASP, Evidence, Grasp, Prediction, Predictions, Touch
from foretouch.types.channels import NO_CHANNELS
from foretouch_msgs.msg import Status, TouchPrediction, TouchPredictionArray, TouchPredictionBatch

pytestmark = pytest.mark.ros

EVIDENCE = Evidence(2, 1.25, 7, 0.5)


def answer(sensor, count=5, **fields):
    """Predictions of random numbers, one of them refused and one without bounds."""
    rng = np.random.default_rng(count)
    grasps, rows = [], []
    for k in range(count):
        g1, g2 = rng.normal(size=(2, 3))
        grasp = Grasp(g1, g2, hand_rotation(g1, g2, np.array([1.0, 0.0, 0.0])), 0.3, f"g-{k}", "1")
        touches = [Touch(rng.normal(2000.0, 1e3, sensor.channels.size), sensor.channels) for _ in range(3)]
        ends = touches if k != 2 else touches[:1]
        flags = (("unfamiliar",), (), ("out_of_range", "unfamiliar"))[k % 3]
        grasps.append(grasp_to_msg(grasp))
        one = Prediction.of(grasp, *ends, reference="touches", flags=flags, evidence=EVIDENCE)
        rows.append(one.row)
    if count > 1:
        rows[1] = refusal("bad_grasp", "é", sensor.channels)
    return TouchAnswer(
        header_to_msg("cam", 5), grasps, Predictions.join(rows), ("late",), Duration(sec=1), "m", "s", sensor, **fields
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
        for k, (predicted, found) in enumerate(zip(one.predictions, message.predictions, strict=True)):
            read = foretouch.reading(found)
            assert (found.sensor, tuple(found.fingers), found.model) == (name, sensor.channels.fingers, "m")
            for channel in sensor.channels.channels:
                for end, many_end, expected in zip(
                    read[channel.name], many[channel.name], predicted[channel.name], strict=True
                ):
                    np.testing.assert_array_equal(end, expected.astype(np.float32))
                    np.testing.assert_array_equal(many_end[k], end)
            back = prediction_from_msg(found, sensor)
            assert (back.status, back.reason) == (read.status, read.reason) == (predicted.status, predicted.reason)
            assert (many.status[k], many.reason[k]) == (predicted.status, predicted.reason)
            if predicted.ok:
                assert (back.reference, back.evidence) == ("touches", EVIDENCE)
                assert back.flags == read.flags == (*predicted.flags, "late")
                assert set(many.flags[k]) == set(read.flags)
                np.testing.assert_array_equal(read.grasp.g1, predicted.grasp.g1)
                np.testing.assert_array_equal(back.value.values, predicted.value.values.astype(np.float32))
            flags = [flag for flag, has in zip(batch.flags, np.reshape(batch.flagged, (5, -1))[k], strict=True) if has]
            assert sorted(flags) == sorted(found.flags)
            assert batch.statuses[k] == found.status
        assert (batch.reference, batch.touches, batch.status, batch.input_age.sec) == (2, 2, Status.OK, 1)

    every_case([(name,) for name in sensor_files()], check)


def test_a_dead_taxel_is_marked_and_numbers_beyond_single_precision_become_infinite():
    sensor = sensor_with_dead("xela_uskin_4x4", 5)
    huge = Touch(np.full(96, 1e300), sensor.channels)
    one = answer(sensor, 1)
    message = TouchAnswer(one.header, one.grasps, Prediction.of(NO_GRASP, huge).row, sensor=sensor).message.predictions[
        0
    ]
    assert np.reshape(message.valid, (2, 16))[0].tolist() == [int(k != 5) for k in range(16)]
    assert np.isinf(message.values).all()


WITHOUT_ROS = """
import sys, foretouch
from types import SimpleNamespace as S
age = S(sec=-1, nanosec=0)
hand = S(id="", object_id="", g1=S(x=0, y=0, z=1), g2=S(x=1, y=0, z=1), rotation=[0] * 9, score=0.5,
         pose=S(orientation=S(x=0, y=0, z=0, w=1)))
message = S(fingers=["a", "b"], channels=["E"], values=[1, 2, 3, 4], lower=[0] * 4, upper=[5] * 4, valid=[1] * 4,
            scalar_channels=[], scalars=[], scalars_lower=[], scalars_upper=[], sensor="s", sensor_sha256="", grasp=hand,
            flags=["late"], status=0, reason="", reference=1, touches=0, readings=1, touch_age=age, reading_age=age)
read = foretouch.reading(message)
assert read["E"].value.tolist() == [[1, 2], [3, 4]] and read["E"].upper.shape == (2, 2)
assert (read.status, read.reference, read.flags, read.grasp.width_m) == ("ok", "tare", ("late",), 1.0)
assert "rclpy" not in sys.modules and "foretouch_msgs" not in sys.modules
"""


def test_a_reading_needs_no_ros_and_arrays_that_do_not_fit_are_refused():
    assert subprocess.run([sys.executable, "-c", WITHOUT_ROS], check=False).returncode == 0
    message = answer(packaged_sensor("biotac_sp"), 1).message.predictions[0]
    fields = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    for name in ("values", "upper", "scalars_lower"):
        with pytest.raises(TactileError, match=f"{name}: 3 values are not 2 x"):
            foretouch.reading(SimpleNamespace(**{**fields, name: [1.0, 2.0, 3.0]}))
    with pytest.raises(ModelError, match=r"sensor: biotac_sp \(\w+\) is not xela_uskin_4x4"):
        prediction_from_msg(message, packaged_sensor("xela_uskin_4x4"))
    message.scalar_channels = ["P"]
    with pytest.raises(TactileError, match="channels: PDC of biotac_sp is missing"):
        prediction_from_msg(message)


def test_without_a_model_every_grasp_has_the_reason_and_no_numbers():
    grasps = answer(packaged_sensor("biotac_sp"), 2).grasps
    none = TouchAnswer(header_to_msg("cam", 5), grasps, refusal("no_model", "absent", NO_CHANNELS, 2))
    message = sent(none.message)
    assert [(prediction.status, prediction.reason, len(prediction.values)) for prediction in message.predictions] == [
        (Status.NO_MODEL, "absent", 0)
    ] * 2
    assert (message.status, message.reason) == (Status.NO_MODEL, "absent")
    batch = sent(none.batch)
    assert (list(batch.statuses), batch.reasons) == ([Status.NO_MODEL] * 2, ["absent"] * 2)
    many = foretouch.reading(batch)
    assert (many.status.tolist(), many.value.shape) == (["no_model"] * 2, (2, 0))
    assert np.isnan(prediction_from_msg(message.predictions[0]).value.values).all()


def test_the_names_of_statuses_and_references_are_those_of_the_messages():
    assert {code: name.upper() for code, name in STATUSES.items()} == {
        getattr(Status, name): name for name in dir(Status) if name.isupper() and name != "SLOT_TYPES"
    }
    assert [getattr(TouchPrediction, name.upper()) for name in REFERENCES] == list(range(len(REFERENCES)))
