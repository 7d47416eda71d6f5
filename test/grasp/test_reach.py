# SPDX-License-Identifier: Apache-2.0
"""Grasps that no hand can execute are refused by name; every recorded grasp is accepted."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case, every_refusal
from scipy.spatial import cKDTree

from foretouch.cloud.geometry.limits import check_object
from foretouch.errors import GraspError
from foretouch.grasp.reach import check_reach, reach_faults
from foretouch.types import Grasp, Grasps
from foretouch.types.rotations import check_rotation


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


def test_grasps_out_of_reach_are_named_and_others_accepted(ball) -> None:
    cases = [
        (r"g1, g2: 1 m apart, more than max_width_m 0\.2", _across(1.0)),
        (r"g1: .* m from the object, more than max_distance_m 0\.05", _across(0.08, 50.0)),
        ("g1, g2: 1e[+]160 m apart", _across(1e160)),
        ("apart, more than", _across(1.7e308)),
        ("g1: 1e[+]160 m from the object", _across(0.08, 1e160)),
        ("g2: .* m from the object", Grasp(np.array([0.0, 0.04, 1.0]), np.array([0.0, -0.12, 1.0]), np.eye(3))),
        ("g1: inf m from the object", _across(0.08), np.full((5, 3), np.nan)),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        every_refusal(GraspError, cases, lambda grasp, xyz=ball: check_reach(grasp, xyz, 0.2, 0.05))
    ball[::3] = np.nan
    check_reach(_across(0.08), ball, 0.2, 0.05)
    check_reach(_across(0.16), ball.reshape(50, 60, 3), 0.2, 0.05)
    far = ball + np.array([0.0, 3.0, 0.0], np.float32)
    far[1234] = [0.04, 0.0, 1.0]  # one near point of many
    far[2345] = [-0.04, 0.0, 1.0]
    check_reach(_across(0.08), far, 0.2, 0.05)


@pytest.mark.real_data
def test_every_recorded_object_and_grasp_is_accepted(real_data: Path) -> None:
    from foretouch.dataset.formats import open_samples

    found = open_samples(str(real_data / "vision2tactile"))
    samples = list(found)
    assert len(samples) >= 400
    for sample in samples:
        check_object(sample.cloud.xyz)
        check_reach(sample.grasp, sample.cloud.xyz, 0.2, 0.05)
        check_rotation(sample.grasp.rotation)


def test_what_is_accepted_is_in_reach(ball, rng) -> None:
    ball[::3] = np.nan
    at = ball[np.isfinite(ball).all(axis=1)][:300].astype(np.float64)
    tree = cKDTree(ball[np.isfinite(ball).all(axis=1)].astype(np.float64))

    def check(distance_m: float) -> None:
        g1, g2 = at.copy(), at[::-1] + rng.normal(size=at.shape) * 10.0 ** rng.uniform(-3.0, 0.0, (300, 1))
        g1[0], g2[1] = 1e100, -1e100
        grasps = Grasps(g1, g2, np.tile(np.eye(3), (300, 1, 1)))
        faults = reach_faults(grasps, ball, 0.08, distance_m)
        away = np.maximum(*(tree.query(contacts)[0] for contacts in (g1, g2)))  # SciPy's k-d tree
        expected = (np.linalg.norm(g1 - g2, axis=1) <= 0.08) & (away <= distance_m)
        assert [not fault for fault in faults] == expected.tolist()
        assert expected.any() == (distance_m > 0.0)

    every_case([0.0, 0.01, 0.05, 0.1], check)
