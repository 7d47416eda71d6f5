# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from every_case import every_case, every_refusal
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from foretouch.errors import GraspError
from foretouch.grasp.pose import closing_faults, hand_rotation, is_parallel
from foretouch.types import Grasp, Grasps
from foretouch.types.rotations import are_rotations, is_rotation, quaternion_xyzw, rotation_faults

X, Y, Z = np.eye(3)
vectors = st.tuples(*[st.floats(-1.0, 1.0, allow_subnormal=False)] * 3).map(np.array)


def test_axes_of_hand_worked_poses():
    # Contacts along x, object along y: Z = x, X = x × y = z, Y = x × z = -y.
    rotation = hand_rotation(np.array([0.05, 0.0, 1.0]), np.array([-0.05, 0.0, 1.0]), Y)
    np.testing.assert_allclose(rotation, np.column_stack([Z, -Y, X]), atol=1e-15)
    # Contacts along the axis: Z = y; x and z are equally far from it, the first stands in: X = y × x = -z.
    along = np.array([0.0, 0.1, 1.0]), np.array([0.0, 0.0, 1.0]), Y
    np.testing.assert_allclose(hand_rotation(*along), np.column_stack([-Z, -X, Y]), atol=1e-15)
    assert is_parallel(*along)


@given(vectors, vectors, vectors)
def test_is_a_proper_rotation_with_z_along_the_contacts(g1, g2, axis):
    if np.linalg.norm(g1 - g2) < 1e-6 or np.linalg.norm(axis) < 1e-6:
        return
    rotation = hand_rotation(g1, g2, axis)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 2], (g1 - g2) / np.linalg.norm(g1 - g2), atol=1e-12)
    if not is_parallel(g1, g2, axis):
        assert abs(rotation[:, 0] @ axis) < 1e-8 * max(1.0, np.linalg.norm(axis))


def test_a_hand_must_close_along_its_contacts_within_thirty_degrees():
    for angle_deg in (0.0, 29.9, 30.1, 90.0, 180.0):
        turned = Rotation.from_rotvec(np.radians(angle_deg) * Y).as_matrix()  # its Z leaves that of the camera
        grasp = Grasp(0.03 * Z, -0.03 * Z, turned)
        expected = "" if angle_deg < 30.0 else f"pose: its Z is {angle_deg:.0f} degrees from g1 - g2, more than 30"
        (fault,) = closing_faults(Grasps.of([grasp]))
        assert fault.split(";")[0] == expected


def test_a_rotation_of_another_convention_is_told_which_column_is_which():
    """Columns as GraspNet orders them, exchanged contacts, rows for columns, and what resembles none of these."""
    g1, g2 = np.array([0.03, 0.01, 0.9]), np.array([-0.03, 0.0, 0.91])
    rotation = hand_rotation(g1, g2, np.array([0.1, 0.5, 1.0]))
    x, y, z = rotation.T
    cases = {
        "approach first": (np.column_stack([-x, z, y]), "the second column is along it"),
        "line first": (np.column_stack([z, x, y]), "the first column is along it"),
        "exchanged": (np.column_stack([x, -y, -z]), "g1 and g2 are exchanged"),
        "rows": (rotation.T, "the third row is along it"),
        "neither": (
            rotation @ Rotation.from_rotvec(0.9 * (X + Y) / np.sqrt(2.0)).as_matrix(),
            "more than 30; the columns are X, Y, Z",
        ),
    }

    def check(turned: np.ndarray, cure: str) -> None:
        (fault,) = closing_faults(Grasps.of([Grasp(g1, g2, turned)]))
        assert "degrees from g1 - g2" in fault
        assert cure in fault

    every_case(cases, check)


def test_what_has_no_pose_is_refused():
    cases = [
        (r"g1 - g2: .* has no direction", X, X, Y),
        (r"axis: .* has no direction", X, Y, np.zeros(3)),
        ("has no direction", np.array([np.nan, 0.0, 0.0]), Y, Z),
    ]
    every_refusal(GraspError, cases, hand_rotation)
    matrices = [np.diag([1.0, 1.0, -1.0]), np.eye(3) * 2.0, np.full((3, 3), np.nan), np.eye(2), np.full((3, 3), 1e300)]
    cases = [(r"rotation: .* is not a rotation matrix", matrix) for matrix in matrices]
    every_refusal(GraspError, cases, quaternion_xyzw)


def test_quaternions_are_those_of_scipy_and_what_is_accepted_is_a_rotation(rng):
    rotations = Rotation.random(200, random_state=0)
    for matrix, expected in zip(rotations.as_matrix(), rotations.as_quat(), strict=True):
        quaternion = quaternion_xyzw(matrix)
        assert quaternion[3] >= 0.0
        np.testing.assert_allclose(quaternion * np.sign(expected[3]), expected, atol=1e-12)
    for axis in (X, Y, Z, (X + Y) / np.sqrt(2.0), (Y - X) / np.sqrt(2.0)):
        quaternion = quaternion_xyzw(2.0 * np.outer(axis, axis) - np.eye(3))
        leading = axis[np.flatnonzero(axis)[0]]  # positive by convention
        np.testing.assert_allclose(quaternion, [*(axis * np.sign(leading)), 0.0], atol=1e-12)
    turns = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(40)])
    turns[:30] *= rng.uniform(0.999, 1.001, (30, 1, 1))
    turns[30], turns[31], turns[32] = 1e300, np.diag([1.0, 1.0, -1.0]), np.eye(3)
    accepted = [not fault for fault in rotation_faults(turns)]
    assert accepted[30:33] == [False, False, True]
    assert 0 < sum(accepted[:30]) < 30
    for k in (*range(30), *range(33, 40)):  # singular values of the matrix, by another formulation
        stretched = np.abs(np.linalg.svd(turns[k], compute_uv=False) ** 2 - 1.0).max() > 1e-3
        assert accepted[k] == (not stretched and np.linalg.det(turns[k]) > 0)


def test_lengths_whose_squares_are_out_of_range_have_the_same_rotation():
    for length in (1e-300, 1e-200, 1e160, 1e300):
        np.testing.assert_allclose(hand_rotation(length * X, -length * X, Y), hand_rotation(X, -X, Y), atol=1e-15)
    g1, axis = np.array([2.0, 4.0, -4.0]), np.array([1.0, 0.5, 0.25])
    expected = hand_rotation(g1, np.zeros(3), axis)
    for scale in (1e-323, 1e-161, 1e-155, 1e155):
        np.testing.assert_allclose(hand_rotation(scale * g1, np.zeros(3), axis), expected, rtol=0.0, atol=1e-15)
        assert not is_parallel(scale * g1, np.zeros(3), axis)
    np.testing.assert_allclose(hand_rotation(g1, np.zeros(3), 1e-155 * axis), expected, rtol=0.0, atol=1e-15)


def test_one_matrix_is_judged_as_many_are() -> None:
    rng = np.random.default_rng(0)
    turned = np.linalg.qr(rng.normal(size=(400, 3, 3)))[0]  # half of them left-handed
    near = turned + rng.normal(size=turned.shape) * np.geomspace(1e-5, 0.1, 400)[:, None, None]
    odd = np.stack(
        [np.zeros((3, 3)), np.ones((3, 3)), np.full((3, 3), np.nan), np.full((3, 3), 1e200), 1.001 * np.eye(3)]
    )
    matrices = np.concatenate([turned, near, odd])
    judged = are_rotations(matrices)
    assert [is_rotation(matrix) for matrix in matrices] == judged.tolist()
    assert 0.1 < judged.mean() < 0.9
