# SPDX-License-Identifier: Apache-2.0
"""Transforms of messages, against SciPy's rotations."""

import copy
import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from shape_msgs.msg import Plane as PlaneMsg

from foretouch.errors import GraspError
from foretouch.grasp import quaternion_xyzw
from foretouch.grasp.messages import decode_grasp, rotation_from_quaternion
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.messages.requests import read_cloud
from foretouch.types import Cloud, Grasp
from foretouch_msgs.msg import Grasp as GraspMsg

pytestmark = pytest.mark.ros

TURN = Rotation.from_euler("zyx", [1.1, -0.4, 2.2])
SHIFT = np.array([0.45, -0.2, 0.8])
TRANSFORM = FrameTransform.from_quaternion("base", "cam", SHIFT, TURN.as_quat())


def to_base(points):
    return TURN.apply(points) + SHIFT


def xyz_of(point):
    return np.array([point.x, point.y, point.z])


def random_grasp(rng):
    return Grasp(rng.normal(size=3), rng.normal(size=3), Rotation.random(random_state=3).as_matrix(), 1.5, "7", "2")


def test_points_and_a_grasp_with_contacts_pose_and_matrix_move_and_points_come_back(rng):
    points, back = rng.normal(size=(50, 3)), TRANSFORM.inverse()
    assert_allclose(TRANSFORM.points(points), to_base(points), atol=1e-15)
    assert_allclose(back.points(TRANSFORM.points(points)), points, atol=1e-14)
    assert (back.target, back.source) == ("cam", "base")
    assert abs(abs(quaternion_xyzw(TRANSFORM.rotation) @ TURN.as_quat()) - 1.0) < 1e-15
    one = random_grasp(rng)
    message = grasp_to_msg(one)
    before = copy.deepcopy(message)
    moved = TRANSFORM.grasp(message)
    assert message == before
    for point, expected in ((moved.g1, one.g1), (moved.g2, one.g2), (moved.pose.position, one.midpoint)):
        assert_allclose(xyz_of(point), to_base(expected), atol=1e-14)
    expected, q = (TURN * Rotation.from_matrix(one.rotation)).as_matrix(), moved.pose.orientation
    quaternion = np.array([q.x, q.y, q.z, q.w])
    for found in (moved.rotation.reshape(3, 3), rotation_from_quaternion(quaternion), decode_grasp(moved).rotation):
        assert_allclose(found, expected, atol=2e-15)
    assert (moved.id, moved.object_id, moved.score) == ("7", "2", 1.5)


def test_an_orientation_of_zeros_stays_a_request_to_compute_it_and_what_is_not_finite_stays_so():
    moved = TRANSFORM.grasp(GraspMsg(pose=Pose(orientation=Quaternion(w=0.0))))
    assert (moved.pose.orientation, np.any(moved.rotation)) == (Quaternion(w=0.0), False)
    message = GraspMsg(g1=Point(x=math.nan), g2=Point(x=1.7e308, y=1.7e308, z=1.7e308))
    message.pose.orientation = Quaternion(x=math.inf, w=1.0)
    moved = TRANSFORM.grasp(message)
    assert np.isnan(xyz_of(moved.g1)).all()
    assert not np.isfinite([*xyz_of(moved.g2), moved.pose.orientation.x]).all()
    with pytest.raises(GraspError):
        decode_grasp(moved)


def test_a_plane_has_the_same_points_and_a_cloud_its_other_fields_and_byte_order(rng):
    normal = np.array([0.6, 0.0, 0.8])
    moved = np.asarray(TRANSFORM.plane(PlaneMsg(coef=np.append(normal, -0.5))).coef)
    within = rng.normal(size=(20, 3))
    within -= np.outer(within @ normal - 0.5, normal)
    assert_allclose(to_base(within) @ moved[:3] + moved[3], 0.0, atol=1e-14)
    assert_array_equal(TRANSFORM.plane(PlaneMsg()).coef, np.zeros(4))
    xyz = rng.normal(size=(4, 5, 3)).astype(np.float32)
    xyz[1, 2] = np.nan
    rgb = rng.integers(0, 255, (4, 5, 3), np.uint8)
    message = cloud_to_msg(Cloud(xyz, rgb, "cam", 5))
    moved = TRANSFORM.cloud(message)
    found = read_cloud(moved)
    assert (found.frame_id, found.stamp_ns, moved.fields) == ("base", 5, message.fields)
    assert_allclose(found.xyz.reshape(-1, 3), to_base(xyz.reshape(-1, 3).astype(float)).astype(np.float32), atol=3e-7)
    assert_array_equal(found.rgb, rgb)
    assert_array_equal(read_cloud(message).xyz, xyz)
    assert TRANSFORM.cloud(cloud_to_msg(Cloud(xyz[:0, 0], None, "cam", 5))).width == 0
    big = cloud_to_msg(Cloud(np.array([[1.0, 2.0, 3.0]], np.float32), None, "cam", 5))
    big.data, big.is_bigendian = np.frombuffer(bytes(big.data), "<f4").astype(">f4").tobytes(), True
    assert_allclose(read_cloud(TRANSFORM.cloud(big)).xyz, [to_base(np.array([1.0, 2.0, 3.0]))], atol=1e-6)
