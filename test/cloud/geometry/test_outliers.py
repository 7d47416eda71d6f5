# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from foretouch.cloud.geometry.outliers import inlier_mask


def test_agrees_with_the_rule_on_scipys_tree(rng):
    xyz = rng.normal(0.0, 0.05, (900, 3)).astype(np.float32)
    distance = cKDTree(xyz).query(xyz, 51)[0][:, 1:].mean(axis=1)
    expected = distance <= distance.mean() + np.std(distance, ddof=1)
    assert np.count_nonzero(inlier_mask(xyz) != expected) == 0


def test_drops_the_far_point():
    line = np.column_stack([np.arange(60) * 0.001, np.zeros(60), np.ones(60)])
    xyz = np.concatenate([line, [[0.5, 0.5, 1.0]]]).astype(np.float32)
    assert not inlier_mask(xyz)[-1]


def test_more_deviations_keep_more(rng):
    xyz = rng.standard_t(2, (500, 3)).astype(np.float32)
    kept = [inlier_mask(xyz, deviations=d) for d in (0.0, 0.5, 1.0, 3.0)]
    assert all((one <= other).all() for one, other in itertools.pairwise(kept))
    assert kept[0].sum() < kept[-1].sum()


def test_moving_and_turning_the_cloud_changes_nothing(rng):
    xyz = rng.normal(0.0, 0.05, (400, 3)).astype(np.float32)
    np.testing.assert_array_equal(inlier_mask(xyz), inlier_mask(np.ascontiguousarray(xyz[:, [1, 2, 0]])))


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_few_points_are_no_outliers(n):
    assert inlier_mask(np.eye(3, dtype=np.float32)[:n]).shape == (n,)
    assert inlier_mask(np.ones((n, 3), np.float32)).all()
