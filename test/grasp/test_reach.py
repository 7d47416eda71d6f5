# SPDX-License-Identifier: Apache-2.0
"""Which grasps a hand can execute on a cloud."""

import numpy as np
import pytest

from foretouch.errors import GraspError
from foretouch.grasp.reach import check_reach
from foretouch.types import Grasp

CLOUD = np.array([[[0.0, 0.0, 0.5], [0.01, 0.0, 0.5]], [[np.nan] * 3, [0.0, 0.01, np.inf]]], np.float32)


def grasp(g1, g2):
    return Grasp(np.array(g1, np.float64), np.array(g2, np.float64), np.eye(3))


def test_a_grasp_on_the_object_passes_with_one_contact_on_the_hidden_side():
    check_reach(grasp([0.0, 0.0, 0.5], [0.0, 0.0, 0.64]), CLOUD, 0.15, 0.1)


@pytest.mark.parametrize("shift", [0.0, 0.09])
def test_the_limits_are_inclusive(shift):
    one = grasp([0.01 + shift, 0.0, 0.5], [0.01 + shift, 0.0, 0.65])
    check_reach(one, CLOUD.astype(np.float64), one.width_m, shift + 1e-7)


@pytest.mark.parametrize("far", [0.2, 1.0, 1e20, 1e160, 1e308])
def test_a_grasp_wider_than_the_hand_is_refused_at_any_size(far):
    with pytest.raises(GraspError, match=r"^g1, g2: \S+ m apart, which is above max_width_m, 0\.15 m$"):
        check_reach(grasp([-far, 0.0, 0.5], [far, 0.0, 0.5]), CLOUD, 0.15, 0.1)


@pytest.mark.parametrize("far", [0.2, 50.0, 1e15])
def test_a_grasp_far_from_its_cloud_is_refused(far):
    with pytest.raises(
        GraspError, match=r"^g1, g2: \S+ m from the nearest point of the cloud, which is above max_dist"
    ):
        check_reach(grasp([far, 0.0, 0.5], [np.nextafter(far, 2 * far), 0.0, 0.5]), CLOUD, 0.15, 0.1)


def test_a_cloud_without_a_finite_point_has_nothing_in_reach():
    with pytest.raises(GraspError, match="inf m from the nearest point"):
        check_reach(grasp([0.0, 0.0, 0.5], [0.0, 0.1, 0.5]), np.full((4, 3), np.nan, np.float32), 0.15, 0.1)
    with pytest.raises(GraspError, match="inf m from the nearest point"):
        check_reach(grasp([0.0, 0.0, 0.5], [0.0, 0.1, 0.5]), np.empty((0, 3), np.float32), 0.15, 0.1)


def test_any_point_of_a_large_cloud_counts():
    cloud = np.full((1000, 3), 9.0, np.float32)
    cloud[63] = 0.0
    check_reach(grasp([0.0, 0.0, 0.01], [0.0, 0.1, 0.01]), cloud, 0.15, 0.02)
