# SPDX-License-Identifier: Apache-2.0
"""Transforms of messages, against SciPy's rotations."""

import copy
import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from shape_msgs.msg import Plane as PlaneMsg
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from foretouch.dataset.messages import decode_grasp, rotation_from_quaternion
from foretouch.errors import GraspError
from foretouch.grasp import quaternion_xyzw
from foretouch.ros.messages.answers import Refusal, TouchAnswer
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.messages.requests import read_cloud
from foretouch.types import Cloud, Grasp
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status, TouchPrediction

pytestmark = pytest.mark.ros

TURN = Rotation.from_euler("zyx", [1.1, -0.4, 2.2])
SHIFT = np.array([0.45, -0.2, 0.8])


@pytest.fixture
def transform() -> FrameTransform:
    return FrameTransform.from_quaternion("base", "cam", SHIFT, TURN.as_quat())


def to_base(points: np.ndarray) -> np.ndarray:
    return TURN.apply(points) + SHIFT


def xyz_of(point: Point) -> np.ndarray:
    return np.array([point.x, point.y, point.z])


def grasp(rng: np.random.Generator) -> Grasp:
    return Grasp(rng.normal(size=3), rng.normal(size=3), Rotation.random(random_state=3).as_matrix(), 1.5, "7", "2")


def test_points_and_their_way_back(transform, rng):
    points = rng.normal(size=(50, 3))
    assert_allclose(transform.points(points), to_base(points), atol=1e-15)
    assert_allclose(transform.inverse().points(transform.points(points)), points, atol=1e-15)
    assert (transform.inverse().target, transform.inverse().source) == ("cam", "base")


def test_a_grasp_moves_with_contacts_pose_and_matrix(transform, rng):
    one = grasp(rng)
    message = grasp_to_msg(one)
    before = copy.deepcopy(message)
    moved = transform.grasp(message)
    assert message == before
    assert_allclose(xyz_of(moved.g1), to_base(one.g1), atol=1e-15)
    assert_allclose(xyz_of(moved.g2), to_base(one.g2), atol=1e-15)
    assert_allclose(xyz_of(moved.pose.position), to_base(one.midpoint), atol=1e-15)
    expected = (TURN * Rotation.from_matrix(one.rotation)).as_matrix()
    assert_allclose(moved.rotation.reshape(3, 3), expected, atol=1e-15)
    q = moved.pose.orientation
    assert_allclose(rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w])), expected, atol=1e-15)
    assert (moved.id, moved.object_id, moved.score) == ("7", "2", 1.5)
    assert_allclose(decode_grasp(moved).rotation, expected, atol=1e-15)


def test_an_orientation_of_zeros_stays_a_request_to_compute_it(transform):
    message = GraspMsg(pose=Pose(orientation=Quaternion(w=0.0)))
    moved = transform.grasp(message)
    assert moved.pose.orientation == Quaternion(w=0.0)
    assert not np.any(moved.rotation)


def test_numbers_that_are_not_finite_stay_so_without_a_warning(transform):
    message = GraspMsg(g1=Point(x=math.nan), g2=Point(x=1.7e308, y=1.7e308, z=1.7e308))
    message.pose.orientation = Quaternion(x=math.inf, w=1.0)
    moved = transform.grasp(message)
    assert np.isnan(xyz_of(moved.g1)).all()
    assert not np.isfinite(xyz_of(moved.g2)).all()
    assert not np.isfinite(moved.pose.orientation.x)
    with pytest.raises(GraspError):
        decode_grasp(moved)


def test_a_plane_has_the_same_points(transform, rng):
    normal = np.array([0.6, 0.0, 0.8])
    moved = np.asarray(transform.plane(PlaneMsg(coef=np.append(normal, -0.5))).coef)
    within = rng.normal(size=(20, 3))
    within -= np.outer(within @ normal - 0.5, normal)
    assert_allclose(to_base(within) @ moved[:3] + moved[3], 0.0, atol=1e-14)
    assert_array_equal(transform.plane(PlaneMsg()).coef, np.zeros(4))


def test_a_cloud_keeps_its_other_fields(transform, rng):
    xyz = rng.normal(size=(4, 5, 3)).astype(np.float32)
    xyz[1, 2] = np.nan
    rgb = rng.integers(0, 255, (4, 5, 3), np.uint8)
    message = cloud_to_msg(Cloud(xyz, rgb, "cam", 5))
    moved = transform.cloud(message)
    found = read_cloud(moved)
    assert (found.frame_id, found.stamp_ns, moved.fields) == ("base", 5, message.fields)
    assert_allclose(found.xyz.reshape(-1, 3), to_base(xyz.reshape(-1, 3).astype(float)).astype(np.float32), atol=3e-7)
    assert_array_equal(found.rgb, rgb)
    assert_array_equal(read_cloud(message).xyz, xyz)
    assert transform.cloud(cloud_to_msg(Cloud(xyz[:0, 0], None, "cam", 5))).width == 0


def test_a_big_endian_cloud(transform):
    message = cloud_to_msg(Cloud(np.array([[1.0, 2.0, 3.0]], np.float32), None, "cam", 5))
    message.data = np.frombuffer(bytes(message.data), "<f4").astype(">f4").tobytes()
    message.is_bigendian = True
    assert_allclose(read_cloud(transform.cloud(message)).xyz, [to_base(np.array([1.0, 2.0, 3.0]))], atol=1e-6)


def test_markers_move_by_their_pose(transform):
    marker = Marker(header=Header(frame_id="cam"), points=[Point(x=1.0)])
    marker.pose.position.y = 2.0
    (moved,) = transform.markers(MarkerArray(markers=[marker])).markers
    assert (moved.header.frame_id, marker.header.frame_id, moved.points) == ("base", "cam", marker.points)
    q = moved.pose.orientation
    drawn = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(xyz_of(moved.points[0])) + xyz_of(moved.pose.position)
    assert_allclose(drawn, to_base(np.array([1.0, 2.0, 0.0])), atol=1e-15)


def test_predictions_and_samples_move_with_all_their_parts(transform, rng):
    one = grasp_to_msg(grasp(rng))
    header = Header(frame_id="cam")
    header.stamp.sec = 5
    prediction = TouchPrediction(header=header, grasp=one, model="m")
    answer = TouchAnswer(header, [one], [Refusal(Status.NO_GRASP, "none")], model="m")
    moved = transform.prediction(prediction)
    (array,) = transform.answer(answer).message.predictions
    assert (array.header, array.grasp, array.model, array.reason) == (moved.header, moved.grasp, "m", "none")
    assert (moved.header.frame_id, moved.header.stamp.sec, moved.model) == ("base", 5, "m")
    assert moved.grasp == transform.grasp(one)
    pose = PoseStamped(header=header, pose=one.pose)
    result = SampleGrasps.Result(grasp_candidates=[pose], grasps=[one], predictions=[prediction], costs=[1.0])
    feedback = SampleGrasps.Feedback(grasp_candidates=[pose], grasps=[one], costs=[1.0])
    for message in (result, feedback):
        found = transform.sampled(message)
        assert found.grasp_candidates[0].pose == found.grasps[0].pose == transform.grasp(one).pose
        assert found.grasp_candidates[0].header.frame_id == "base"
        assert list(found.costs) == [1.0]
    assert transform.sampled(result).predictions[0] == moved
    assert pose.header.frame_id == prediction.header.frame_id == "cam"


@pytest.mark.parametrize(
    ("translation", "rotation", "reason"),
    [
        ([math.nan, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], "translation"),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.9], "length 0.9"),
        ([0.0, 0.0, 0.0], [0.0, 0.0, math.inf, 1.0], "is not 1"),
    ],
)
def test_what_is_no_rigid_transform_is_refused(translation, rotation, reason):
    with pytest.raises(GraspError, match=reason):
        FrameTransform.from_quaternion("base", "cam", np.array(translation), np.array(rotation))


def test_the_quaternion_of_a_transform_is_exact(transform):
    assert abs(abs(quaternion_xyzw(transform.rotation) @ TURN.as_quat()) - 1.0) < 1e-15
