# SPDX-License-Identifier: Apache-2.0
"""What is received is what was sent, to the last bit, or refused with a status and a reason in one line."""

import copy
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from answer_builders import refusal, touch_message
from every_case import every_case
from geometry_msgs.msg import Pose, Quaternion
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane as PlaneMsg

from foretouch.cli.answers import answer_record
from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.cloud.messages import decode_plane
from foretouch.errors import CloudError, GraspError, ModelError
from foretouch.grasp.messages import (
    decode_grasp,
    decode_grasps,
    encode_grasp,
    has_orientation,
    rotation_from_quaternion,
)
from foretouch.ros.messages.conversions import (
    duration_to_msg,
    grasp_to_msg,
    header_to_msg,
    plane_to_msg,
    prediction_from_msg,
    reference_text,
)
from foretouch.ros.messages.requests import RefusalError, read_objects
from foretouch.tactile import biotac_touch
from foretouch.types import Grasp, Plane, Prediction, WayIn
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TablePlane, TouchPredictionArray

UNIT = Grasp(np.zeros(3), np.ones(3), np.eye(3))


@given(st.floats(min_value=-1e9, max_value=1e9))
def test_durations_may_be_negative_and_are_limited(seconds):
    message = duration_to_msg(seconds)
    assert message.sec + message.nanosec * 1e-9 == pytest.approx(seconds, abs=1e-6)
    serialize_message(duration_to_msg(6e9 * seconds))  # beyond the message


def test_a_grasp_is_received_to_the_last_bit_with_its_pose(rng):
    for _ in range(50):
        grasp = Grasp(*rng.normal(size=(2, 3)), Rotation.random(rng=rng).as_matrix(), 1.5, "id", "2")
        message = deserialize_message(serialize_message(grasp_to_msg(grasp)), GraspMsg)
        back = decode_grasp(message)
        for name in ("g1", "g2", "rotation"):
            np.testing.assert_array_equal(getattr(back, name), getattr(grasp, name))
        assert (back.id, back.object_id, back.score) == ("id", "2", 1.5)
        p, q = message.pose.position, message.pose.orientation
        np.testing.assert_allclose([p.x, p.y, p.z], (grasp.g1 + grasp.g2) / 2)
        quaternion = np.array([q.x, q.y, q.z, q.w])
        np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), grasp.rotation, atol=1e-12)
        np.testing.assert_allclose(rotation_from_quaternion(quaternion), grasp.rotation, atol=1e-12)
        message.rotation = np.zeros(9)  # the quaternion alone
        np.testing.assert_allclose(decode_grasp(message).rotation, grasp.rotation, atol=1e-12)


def way_in(hand: str = "shadow_thumb_middle") -> WayIn:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix(), [0.1, 0.2, 0.3]
    rows = np.linspace(-0.01, 0.03, 22).reshape(2, 11).astype(np.float32).astype(np.float64)
    joints = ("rh_MFJ4", "rh_THJ1")
    return WayIn(np.array([0.0, 0.6, 0.8]), "g2", 0.03125, rows, pose, np.array([0.1, -0.4]), joints, hand)


def test_how_a_hand_comes_to_a_grasp_is_received_as_it_was_sent():
    grasp = replace(UNIT, way=way_in())
    message = deserialize_message(serialize_message(grasp_to_msg(grasp)), GraspMsg)
    assert message.width_m == np.float32(np.sqrt(3.0))
    back = decode_grasp(message).way
    assert back is not None
    for name in ("approach", "approaches", "posture"):
        np.testing.assert_array_equal(getattr(back, name), getattr(grasp.way, name))
    np.testing.assert_allclose(back.pose_of_hand, grasp.way.pose_of_hand, atol=1e-12)
    for name in ("thumb_at", "depth_m", "joints", "hand"):
        assert getattr(back, name) == getattr(grasp.way, name)
    assert decode_grasp(grasp_to_msg(UNIT)).way is None
    older = SimpleNamespace(
        **{name: getattr(message, name) for name in ("id", "object_id", "g1", "g2", "pose", "rotation", "score")}
    )
    assert decode_grasp(older).way is None  # a recording of 0.3


def test_a_grasp_is_written_alike_for_rclpy_and_for_recordings():
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    ends = np.array([0.03, 0.0, 0.8]), np.array([-0.03, 0.0, 0.8])
    for way in (None, way_in()):
        grasp = Grasp(*ends, turn, 0.5, "a", "7", way, ("may_not_fit",))
        sent, plain = grasp_to_msg(grasp, Status.BAD_GRASP, "why"), encode_grasp(grasp, Status.BAD_GRASP, "why")
        names = vars(plain).keys()
        assert names <= set(sent.get_fields_and_field_types())
        assert plain_of(sent, names) == plain_of(plain, names)


def plain_of(message, names):
    """The fields of a message as plain numbers and texts, whichever library it is of."""
    if not hasattr(message, "__dict__") and not hasattr(message, "get_fields_and_field_types"):
        return message.tolist() if hasattr(message, "tolist") else message
    if names is None:
        names = vars(message) if type(message).__name__ == "SimpleNamespace" else message.get_fields_and_field_types()
    return {name: plain_of(getattr(message, name), None) for name in names}


def test_a_way_in_that_cannot_be_used_is_refused_by_name():
    def check(match, name, value):
        message = grasp_to_msg(replace(UNIT, way=way_in()))
        setattr(message, name, value)
        with pytest.raises(GraspError, match=match):
            decode_grasp(message)

    cases = [
        (r"approaches: 3 numbers are not 2 x 11", "approaches", [0.0, 1.0, 2.0]),
        (r"approaches: .*nan.* is not finite", "approaches", [math.nan] * 22),
        (r"posture: 1 angles do not fit 2 joints", "posture", [0.5]),
        (r"thumb_at: 'g3' is neither g1 nor g2", "thumb_at", "g3"),
        (r"depth_m: inf is not finite", "depth_m", math.inf),
        (r"orientation: length 0.* is not 1", "pose_of_hand", Pose(orientation=Quaternion(w=0.0))),
    ]
    every_case(cases, check)


def test_a_grasp_that_cannot_be_used_is_refused_by_name():
    def check(match, spoil):
        message = grasp_to_msg(UNIT)
        spoil(message)
        with pytest.raises(GraspError, match=match):
            decode_grasp(message)

    cases = [
        (r"g1: .*nan.* is not finite", lambda m: setattr(m.g1, "x", math.nan)),
        (r"g2: .*inf.* is not finite", lambda m: setattr(m.g2, "z", math.inf)),
        (r"g1, g2: both contacts are at", lambda m: setattr(m, "g2", m.g1)),
        (r"orientation: length 5.* is not 1", lambda m: setattr(m.pose.orientation, "w", 5.0)),
        (r"orientation: length nan", lambda m: setattr(m.pose.orientation, "x", math.nan)),
        (r"rotation: .* is not a rotation", lambda m: setattr(m, "rotation", np.full(9, 0.5))),
        (r"rotation: .* is not a rotation", lambda m: setattr(m, "rotation", np.full(9, math.nan))),
        (r"rotation: differs from pose", lambda m: setattr(m, "rotation", np.diag([1.0, -1.0, -1.0]).ravel())),
    ]
    every_case(cases, check)
    message = grasp_to_msg(UNIT)
    assert has_orientation(message)
    assert not has_orientation(GraspMsg())  # w = 1
    message.rotation, message.pose.orientation.w = np.zeros(9), 0.0
    assert not has_orientation(message)
    with pytest.raises(GraspError, match="no orientation"):
        decode_grasp(message)


def test_many_grasps_are_read_as_each_by_itself(rng):
    def turn(message, values):
        message.pose.orientation = Quaternion(**dict(zip("xyzw", map(float, values), strict=True)))

    def scale(message, factor):
        message.rotation = factor * np.asarray(message.rotation)

    zeros, new = (0, 0, 0, 0), (0, 0, 0, 1)
    changes = [
        lambda _: None,
        lambda m: setattr(m, "flags", ["may_not_fit"]),
        lambda m: setattr(m, "rotation", np.zeros(9)),
        lambda m: turn(m, zeros),
        lambda m: turn(m, new),
        lambda m: (setattr(m, "rotation", np.zeros(9)), turn(m, zeros)),
        lambda m: (setattr(m, "rotation", np.zeros(9)), turn(m, new)),
        *(lambda m, factor=factor: scale(m, factor) for factor in (1.0001, 1.0004, 1.01, -1.0, math.nan)),
        lambda m: setattr(m.pose.orientation, "x", 1.0006 * m.pose.orientation.x),
        lambda m: setattr(m.pose.orientation, "y", math.inf),
        lambda m: setattr(m.g1, "x", math.nan),
        lambda m: setattr(m, "g2", m.g1),
        lambda m: setattr(m, "hand", "two_tips"),
    ]
    messages = []
    for k, change in enumerate(3 * changes):
        grasp = Grasp(*rng.normal(size=(2, 3)), Rotation.random(rng=rng).as_matrix(), 0.5 * k, f"id/{k}", str(k))
        messages.append(grasp_to_msg(grasp))
        change(messages[-1])
    read, turned, reasons = decode_grasps(messages)
    for k, message in enumerate(messages):
        assert turned[k] == has_orientation(message)
        rotation = None if turned[k] else np.eye(3)
        if reasons[k]:
            with pytest.raises(GraspError) as refusal:
                decode_grasp(message, rotation)
            assert (str(refusal.value), read.object_id[k], np.isnan(read.g1[k]).all()) == (reasons[k], str(k), True)
            continue
        alone = decode_grasp(message, rotation)
        for name in ("g1", "g2", "rotation", "score", "id", "object_id", "flags"):
            np.testing.assert_array_equal(getattr(read, name)[k], getattr(alone, name))
    assert 15 < sum(map(bool, reasons)) < len(messages) - 15
    assert len(decode_grasps([])[0]) == 0


def test_planes_are_received_to_the_last_bit_or_refused_with_a_reason(rng):
    for plane in (Plane.from_coefficients(rng.normal(size=4)) for _ in range(50)):
        np.testing.assert_array_equal(decode_plane(plane_to_msg(plane)).coefficients, plane.coefficients)
    message = plane_to_msg(None)
    assert decode_plane(message) is None
    message.coef = np.array([0.0, 0.0, -2.0, 3.0])
    np.testing.assert_array_equal(decode_plane(message).coefficients, [0.0, 0.0, -1.0, 1.5])
    message.coef[1] = math.nan
    with pytest.raises(CloudError, match="not four finite numbers"):
        decode_plane(message)

    def check(status, reason, refused_as, text):
        table = TablePlane(header=HEADER, plane=PlaneMsg(), status=status, reason=reason)
        with pytest.raises(RefusalError) as refusal:
            read_objects(PointCloud2(header=HEADER), table, ObjectLimits())
        assert (refusal.value.status, refusal.value.reason) == (refused_as, text)

    cases = [
        (Status.NO_PLANE, "no plane", Status.NO_PLANE, "no plane"),
        (Status.NO_PLANE, "", Status.NO_PLANE, "table: status no_plane without a reason"),
        (250, "", Status.BAD_REQUEST, "table: status 250 is unknown"),
        (Status.NO_OBJECT, "a\nb", Status.NO_OBJECT, r"a\nb"),
    ]
    every_case(cases, check)


HEADER = header_to_msg("camera", 5)


def test_a_prediction_with_an_unknown_reference_is_refused_and_still_printed():
    prediction = Prediction.of(UNIT, biotac_touch(np.full(50, 2000.0)))
    on_third = grasp_to_msg(replace(UNIT, object_id="3"))
    good, strange = (touch_message(prediction, copy.deepcopy(on_third), HEADER) for _ in range(2))
    strange.reference = 77
    reason = "reference: 77 is not one of none, tare, touches, history"
    with pytest.raises(ModelError, match=reason):
        prediction_from_msg(strange)
    assert reference_text(strange) == "reference 77"
    bad = copy.deepcopy(on_third)
    bad.g1.x = float("nan")
    refused = touch_message(refusal("bad_grasp", "g1: is not finite"), bad, HEADER)
    lines = answer_record(TouchPredictionArray(header=HEADER, predictions=[good, strange, refused]))["predictions"]
    assert (lines[0]["status"], lines[0]["object"]) == ("ok", "3")
    assert lines[1] == {"object": "3", "status": "failed", "reason": reason}
    assert lines[2]["PDC_TH"] == {"value": None, "lower": None, "upper": None}
    assert [lines[2][name] for name in ("object", "grasp", "status", "reason")] == [
        *("3", None, "bad_grasp", "g1: is not finite")
    ]
