# SPDX-License-Identifier: Apache-2.0
"""Grasps that no hand can execute are refused by name; every recorded grasp is accepted."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from foretouch.errors import GraspError
from foretouch.grasp.pose import check_rotation, surely_rotations
from foretouch.grasp.reach import check_reach, surely_in_reach
from foretouch.types import Grasp


@pytest.fixture
def ball() -> np.ndarray:
    """A ball of 80 mm, 1 m away."""
    points = np.random.default_rng(0).normal(size=(3000, 3))
    points *= 0.04 / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.0, 0.0, 1.0])).astype(np.float32)


def _across(width_m: float, offset_m: float = 0.0) -> Grasp:
    half = np.array([width_m / 2.0, 0.0, 0.0])
    middle = np.array([0.0, offset_m, 1.0])
    return Grasp(middle + half, middle - half, np.eye(3))


@pytest.mark.parametrize(
    ("grasp", "reason"),
    [
        (_across(1.0), r"g1, g2: 1 m apart, more than max_width_m 0\.2"),
        (_across(0.08, 50.0), r"g1: .* m from the object, more than max_distance_m 0\.05"),
        (_across(1e160), "g1, g2: 1e[+]160 m apart"),
        (_across(1.7e308), "apart, more than"),
        (_across(0.08, 1e160), "g1: 1e[+]160 m from the object"),
        (Grasp(np.array([0.0, 0.04, 1.0]), np.array([0.0, -0.12, 1.0]), np.eye(3)), "g2: .* m from the object"),
    ],
)
def test_grasps_out_of_reach_are_named(ball, grasp: Grasp, reason: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(GraspError, match=reason):
            check_reach(grasp, ball, 0.2, 0.05)


def test_grasps_within_reach_are_accepted(ball) -> None:
    ball[::3] = np.nan
    check_reach(_across(0.08), ball, 0.2, 0.05)
    check_reach(_across(0.16), ball.reshape(50, 60, 3), 0.2, 0.05)


def test_one_near_point_of_many_is_found(ball) -> None:
    far = ball + np.array([0.0, 3.0, 0.0], np.float32)
    far[1234] = [0.04, 0.0, 1.0]
    far[2345] = [-0.04, 0.0, 1.0]
    check_reach(_across(0.08), far, 0.2, 0.05)


def test_a_cloud_without_a_finite_point_is_out_of_reach() -> None:
    with pytest.raises(GraspError, match="g1: inf m from the object"):
        check_reach(_across(0.08), np.full((5, 3), np.nan), 0.2, 0.05)


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.ones((3, 3)), np.full((3, 3), 1e300)]
)
def test_matrices_that_are_no_rotations_are_named(matrix) -> None:
    with pytest.raises(GraspError, match=r"rotation: .* is not a rotation matrix"):
        check_rotation(matrix)


@pytest.mark.real_data
def test_every_recorded_grasp_is_accepted(real_data: Path) -> None:
    from foretouch.dataset.samples import open_samples

    with open_samples(str(real_data / "vision2tactile")) as found:
        samples = [record.sample for record in found.records()]
    assert len(samples) >= 400
    for sample in samples:
        check_reach(sample.grasp, sample.cloud.xyz, 0.2, 0.05)
        check_rotation(sample.grasp.rotation)


def _accepts(check, *arguments) -> bool:
    try:
        check(*arguments)
    except GraspError:
        return False
    return True


@pytest.mark.parametrize("distance_m", [0.0, 0.01, 0.05, 0.1])
def test_what_is_surely_in_reach_is_accepted(ball, distance_m: float, rng) -> None:
    """Of many grasps at once; the others are checked one by one."""
    ball[::3] = np.nan
    at = ball[np.isfinite(ball).all(axis=1)][:300].astype(np.float64)
    g1, g2 = at, at[::-1] + rng.normal(size=at.shape) * 10.0 ** rng.uniform(-3.0, 0.0, (300, 1))
    g1[0], g2[1] = 1e160, -1e300
    found = surely_in_reach(g1, g2, ball, 0.08, distance_m)
    accepted = [
        _accepts(check_reach, Grasp(a, b, np.eye(3)), ball, 0.08, distance_m) for a, b in zip(g1, g2, strict=True)
    ]
    assert not (found & ~np.array(accepted)).any()
    assert found.any() == (distance_m > 0.0)


def test_what_is_surely_a_rotation_is_accepted(rng) -> None:
    turns = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(40)])
    turns[:30] *= rng.uniform(0.999, 1.001, (30, 1, 1))
    turns[30], turns[31], turns[32] = 1e300, np.diag([1.0, 1.0, -1.0]), np.eye(3)
    found = surely_rotations(turns)
    accepted = [_accepts(check_rotation, one) for one in turns]
    assert found[32]
    assert not (found & ~np.array(accepted)).any()
