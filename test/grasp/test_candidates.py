# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from foretouch.errors import CloudError
from foretouch.grasp import GeoGraspConfig
from foretouch.grasp.ranking import contact_radius, contact_side, find_grasp_plane

CONFIG = GeoGraspConfig()
Y = np.array([0.0, 1.0, 0.0])


def test_initial_points_are_the_extremes_near_the_plane():
    xyz = np.array([[-9, 0.02, 1], [-1, 0.001, 1], [0, 0, 1], [2, -0.006, 1], [5, 0.0071, 1]], np.float32)
    grasp_plane = find_grasp_plane(xyz, np.array([0.0, 0.0, 1.0]), Y, 0, 0.007)
    assert (grasp_plane.first, grasp_plane.second, grasp_plane.n_points) == (1, 3, 3)
    assert grasp_plane.width_m == pytest.approx(np.hypot(3.0, 0.007))


def test_the_first_of_equal_extremes_counts():
    xyz = np.array([[0, 0, 1], [1, 0, 1], [1, 0.001, 1], [0, 0.001, 1]], np.float32)
    grasp_plane = find_grasp_plane(xyz, np.array([0.0, 0.0, 1.0]), Y, 0, 0.007)
    assert (grasp_plane.first, grasp_plane.second) == (0, 1)


def test_a_plane_without_points_is_reported():
    xyz = np.array([[0, 0.1, 1], [1, -0.1, 1]], np.float32)
    with pytest.raises(CloudError, match=r"no point within 7 mm .* spans -0.100 ... 0.100 m"):
        find_grasp_plane(xyz, np.array([0.0, 0.0, 1.0]), Y, 0, 0.007)


def test_a_plane_with_one_point_is_reported():
    with pytest.raises(CloudError, match="the 1 points near the grasp plane leave no two contacts"):
        find_grasp_plane(np.ones((1, 3), np.float32), np.ones(3), Y, 0, 0.007)


@pytest.mark.parametrize(("width", "radius"), [(0.2, 0.05), (0.1, 0.035), (0.06, 0.021)])
def test_two_spheres_of_candidates_stay_apart(width, radius):
    assert contact_radius(width, CONFIG) == pytest.approx(radius)


def test_candidates_average_their_voxels(rng):
    xyz = rng.uniform([-0.02, -0.02, 0.98], [0.02, 0.02, 1.02], (400, 3)).astype(np.float32)
    candidates, initial, n_near = contact_side(xyz, 7, 0.015, CONFIG)
    assert n_near == np.count_nonzero(np.linalg.norm(xyz.astype(float) - xyz[7], axis=1) < 0.015)
    np.testing.assert_allclose(np.linalg.norm(candidates.normal, axis=1), 1.0)
    np.testing.assert_array_equal(initial.xyz[0], xyz[7])
    cells = {tuple(cell) for cell in np.floor(candidates.xyz / CONFIG.voxel_m).astype(int)}
    assert len(cells) == len(candidates.xyz)


def test_a_point_without_a_normal_takes_it_from_its_voxel():
    plane = np.column_stack(
        [*(g.ravel() for g in np.meshgrid(np.arange(20) * 0.002, np.arange(20) * 0.002)), np.ones(400)]
    )
    lonely = [[0.5, 0.0, 1.0]]
    xyz = np.concatenate([plane, lonely]).astype(np.float32)
    candidates, initial, n_near = contact_side(xyz, 400, 0.02, CONFIG)
    assert n_near == 1
    assert np.isnan(candidates.normal).all()
    assert np.isnan(initial.curvature).all()
