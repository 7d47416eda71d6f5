# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from foretouch.cloud.geometry.outliers import mean_neighbour_distance


@pytest.mark.parametrize("k", [1, 7, 50])
def test_agrees_with_scipys_tree(k, rng):
    xyz = rng.normal(0.0, 0.1, (700, 3)).astype(np.float32)
    expected = cKDTree(xyz).query(xyz, k + 1)[0][:, 1:].mean(axis=1)
    np.testing.assert_allclose(mean_neighbour_distance(xyz, k), expected, rtol=1e-6)


def test_fewer_points_than_neighbours_average_all_others():
    xyz = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0]], np.float32)
    np.testing.assert_array_equal(mean_neighbour_distance(xyz, 50), np.array([2.0, 1.5, 2.5], np.float32))


@pytest.mark.parametrize("n", [0, 1])
def test_no_neighbours_no_distance(n):
    np.testing.assert_array_equal(mean_neighbour_distance(np.ones((n, 3), np.float32), 50), np.zeros(n))


def test_points_in_one_place_are_at_no_distance():
    assert mean_neighbour_distance(np.ones((3000, 3), np.float32), 50).max() == 0.0


def test_does_not_hang_on_the_order(rng):
    xyz = rng.normal(0.0, 0.1, (300, 3)).astype(np.float32)
    order = rng.permutation(300)
    np.testing.assert_array_equal(mean_neighbour_distance(xyz[order], 20), mean_neighbour_distance(xyz, 20)[order])
