# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from foretouch.dataset.messages import decode_grasp, decode_grasps, has_orientation, rotation_from_quaternion
from foretouch.errors import CloudError, GraspError
from foretouch.grasp.pose import hand_rotation
from foretouch.ros.messages import conversions
from foretouch.ros.messages.conversions import (
    duration_to_msg,
    grasp_to_msg,
    plane_from_msg,
    plane_to_msg,
    prediction_to_msg,
    refusal_to_msg,
    stamp_to_msg,
)
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Evidence, Grasp, Plane, Touch, TouchPrediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status


def random_grasp(rng):
    g1, g2 = rng.normal(size=(2, 3))
    return Grasp(g1, g2, Rotation.random(rng=rng).as_matrix(), 1.5, "id", "2")


@given(st.integers(min_value=0, max_value=2**31 * 10**9 - 1))
def test_stamps_keep_every_nanosecond(nanoseconds):
    message = stamp_to_msg(nanoseconds)
    assert 0 <= message.nanosec < 10**9
    assert stamp_ns(message) == nanoseconds


@given(st.floats(min_value=-1e9, max_value=1e9))
def test_durations_may_be_negative(seconds):
    message = duration_to_msg(seconds)
    assert message.sec + message.nanosec * 1e-9 == pytest.approx(seconds, abs=1e-6)


def test_a_duration_beyond_the_message_stays_representable():
    serialize_message(duration_to_msg(1.8e9 * 3))


def test_a_grasp_survives_the_wire_to_the_last_bit(rng):
    for _ in range(50):
        grasp = random_grasp(rng)
        wire = deserialize_message(serialize_message(grasp_to_msg(grasp)), GraspMsg)
        back = decode_grasp(wire)
        for name in ("g1", "g2", "rotation"):
            np.testing.assert_array_equal(getattr(back, name), getattr(grasp, name))
        assert (back.id, back.object_id, back.score) == ("id", "2", 1.5)


def test_the_pose_is_the_midpoint_and_the_rotation_as_scipy_reads_it(rng):
    grasp = random_grasp(rng)
    pose = grasp_to_msg(grasp).pose
    q = pose.orientation
    np.testing.assert_allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), grasp.rotation, atol=1e-12)
    np.testing.assert_allclose([pose.position.x, pose.position.y, pose.position.z], (grasp.g1 + grasp.g2) / 2)


def test_a_quaternion_alone_will_do(rng):
    grasp = random_grasp(rng)
    message = grasp_to_msg(grasp)
    message.rotation = np.zeros(9)
    np.testing.assert_allclose(decode_grasp(message).rotation, grasp.rotation, atol=1e-12)


def test_quaternions_agree_with_scipy(rng):
    for rotation in Rotation.random(20, rng=rng):
        np.testing.assert_allclose(rotation_from_quaternion(rotation.as_quat()), rotation.as_matrix(), atol=1e-14)


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda m: setattr(m.g1, "x", math.nan), r"g1: .*nan.* is not finite"),
        (lambda m: setattr(m.g2, "z", math.inf), r"g2: .*inf.* is not finite"),
        (lambda m: setattr(m, "g2", m.g1), r"g1, g2: both contacts are at"),
        (lambda m: setattr(m.pose.orientation, "w", 5.0), r"orientation: length 5.* is not 1"),
        (lambda m: setattr(m.pose.orientation, "x", math.nan), r"orientation: length nan"),
        (lambda m: setattr(m, "rotation", np.full(9, 0.5)), r"rotation: .* is not a rotation"),
        (lambda m: setattr(m, "rotation", np.full(9, math.nan)), r"rotation: .* is not a rotation"),
        (lambda m: setattr(m, "rotation", np.diag([1.0, -1.0, -1.0]).ravel()), r"rotation: is not that of pose"),
    ],
)
def test_a_spoilt_grasp_is_refused_by_name(spoil, match):
    message = grasp_to_msg(Grasp(np.zeros(3), np.ones(3), np.eye(3)))
    spoil(message)
    with pytest.raises(GraspError, match=match):
        decode_grasp(message)


def test_no_orientation_is_recognised():
    message = grasp_to_msg(Grasp(np.zeros(3), np.ones(3), np.eye(3)))
    assert has_orientation(message)
    message.rotation = np.zeros(9)
    message.pose.orientation.w = 0.0
    assert not has_orientation(message)
    with pytest.raises(GraspError, match="no orientation"):
        decode_grasp(message)


def test_a_plane_survives_to_the_last_bit(rng):
    for _ in range(50):
        plane = Plane.from_coefficients(rng.normal(size=4))
        back = plane_from_msg(plane_to_msg(plane))
        np.testing.assert_array_equal(back.coefficients, plane.coefficients)


def test_four_zeros_are_no_plane_and_nonsense_is_refused():
    assert plane_from_msg(plane_to_msg(None)) is None
    message = plane_to_msg(None)
    message.coef = np.array([0.0, 0.0, 0.0, 1.0])
    with pytest.raises(CloudError, match="normal has zero length"):
        plane_from_msg(message)
    message.coef = np.array([0.0, math.nan, 1.0, 1.0])
    with pytest.raises(CloudError, match="not four finite numbers"):
        plane_from_msg(message)


def test_a_plane_of_another_scale_is_normalised():
    message = plane_to_msg(None)
    message.coef = np.array([0.0, 0.0, -2.0, 3.0])
    np.testing.assert_array_equal(plane_from_msg(message).coefficients, [0.0, 0.0, -1.0, 1.5])


def test_a_prediction_puts_each_electrode_in_its_place():
    vector = np.arange(50.0) + 100.0
    grasp = grasp_to_msg(Grasp(np.zeros(3), np.ones(3), np.eye(3)))
    prediction = TouchPrediction(
        decode_grasp(grasp),
        Touch.from_vector(vector),
        lower=Touch.from_vector(vector - 10),
        flags=("unfamiliar",),
        reference="tare",
    )
    message = prediction_to_msg(prediction, grasp, Header(frame_id="cam"))
    assert (message.pdc_th.value, message.pdc_mf.value) == (100.0, 101.0)
    assert [i.value for i in message.e_th] == list(range(102, 126))
    assert [i.value for i in message.e_mf] == list(range(126, 150))
    assert message.e_mf[23].lower == 139.0
    assert math.isnan(message.e_mf[23].upper)
    assert message.reference == message.TARE
    assert list(message.flags) == ["unfamiliar"]
    assert message.status == Status.OK


def test_a_refusal_says_why_and_holds_no_number():
    grasp = grasp_to_msg(Grasp(np.zeros(3), np.ones(3), np.eye(3)))
    message = refusal_to_msg(grasp, Header(), Status.NO_MODEL, "absent")
    assert (message.status, message.reason) == (Status.NO_MODEL, "absent")
    assert all(math.isnan(i.value) for i in (message.pdc_th, message.pdc_mf, *message.e_th, *message.e_mf))


def test_a_message_without_constructor_equals_the_constructed_one(monkeypatch: pytest.MonkeyPatch) -> None:
    value, low, high = (Touch.from_vector(np.arange(50.0) + shift) for shift in (0.5, -10.0, 10.0))
    rotation = np.eye(3)
    grasp = Grasp(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.05, 1.0]), rotation, id="a")
    prediction = TouchPrediction(grasp, value, low, high, "touches", ("late",), evidence=Evidence(2, 3.5, 4, 1.0))
    header = Header(frame_id="cam")
    for one in (prediction, TouchPrediction(grasp, value)):
        made = conversions.prediction_to_msg(one, conversions.grasp_to_msg(grasp), header)
        monkeypatch.setattr(conversions, "_UNCHECKED", False)
        constructed = conversions.prediction_to_msg(one, conversions.grasp_to_msg(grasp), header)
        monkeypatch.undo()
        assert serialize_message(made) == serialize_message(constructed)
        assert str(made) == str(constructed)
        assert made.get_fields_and_field_types() == constructed.get_fields_and_field_types()


def test_many_grasps_are_decoded_as_one_by_one():
    rng = np.random.default_rng(0)
    messages = []
    for k in range(60):
        g1, g2 = rng.normal(size=(2, 3))
        message = grasp_to_msg(Grasp(g1, g2, hand_rotation(g1, g2, np.array([1.0, 0.1, 0.0])), 0.25, str(k), "1"))
        spoil = k % 6
        if spoil == 1:
            message.rotation = np.zeros(9)
        elif spoil == 2:
            message.pose.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)
        elif spoil == 3:
            message.rotation = message.rotation * rng.choice([1.1, math.nan, 1e200])
        elif spoil == 4:
            message.g1.x = rng.choice([math.nan, math.inf])
        elif spoil == 5 and k > 30:
            message.g2 = message.g1
        messages.append(message)
    decoded = 0
    for message, found in zip(messages, decode_grasps(messages), strict=True):
        if found is not None:
            expected = decode_grasp(message)
            for name in ("g1", "g2", "rotation"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
            assert (found.score, found.id, found.object_id) == (expected.score, expected.id, expected.object_id)
            decoded += 1
    assert decoded == 25
    assert decode_grasps([]) == []
