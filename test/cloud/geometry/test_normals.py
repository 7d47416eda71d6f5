# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from foretouch.cloud.geometry.normals import count_without_normal, normals_and_curvature


def _bumpy(rng, n=1500):
    x, y = rng.uniform(-0.08, 0.08, (2, n))
    return np.column_stack([x, y, 1.0 + 5.0 * x**2 + 0.01 * np.sin(60 * y) + rng.normal(0, 0.001, n)]).astype(
        np.float32
    )


def test_agrees_with_a_tree_and_one_covariance_at_a_time(rng):
    xyz = _bumpy(rng)
    query = rng.choice(len(xyz), 200, replace=False)
    normals, curvature = normals_and_curvature(xyz, query, 0.03)
    tree = cKDTree(xyz)
    for i, normal, k in zip(query, normals, curvature, strict=True):
        near = xyz[tree.query_ball_point(xyz[i], 0.03)].astype(float)
        values, vectors = np.linalg.eigh(np.cov(near.T))
        assert abs(normal @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-6)
        assert k == pytest.approx(values[0] / values.sum(), rel=1e-6)


def test_normals_look_at_the_sensor(rng):
    xyz = _bumpy(rng)
    normals, _ = normals_and_curvature(xyz, np.arange(len(xyz)))
    assert (np.einsum("ij,ij->i", normals, xyz) <= 0).all()


def test_turns_with_the_cloud(rng):
    xyz = _bumpy(rng)
    turn = Rotation.random(random_state=2).as_matrix()
    query = np.arange(0, len(xyz), 10)
    normals, curvature = normals_and_curvature(xyz, query)
    turned, same = normals_and_curvature((xyz @ turn.T).astype(np.float32), query)
    np.testing.assert_allclose(same, curvature, atol=1e-4)
    assert np.median(np.abs(np.einsum("ij,ij->i", turned, normals @ turn.T))) > 0.99999


def test_an_exact_plane_has_no_curvature():
    x, y = np.meshgrid(np.arange(30) * 0.002, np.arange(30) * 0.002)
    xyz = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]).astype(np.float32)
    normals, curvature = normals_and_curvature(xyz, np.array([0, 450]))
    np.testing.assert_allclose(normals, [[0, 0, -1]] * 2, atol=1e-7)
    np.testing.assert_allclose(curvature, 0.0, atol=1e-12)


def test_neighbours_are_strictly_within_the_radius():
    # Three points around the first: one on the limit, exactly representable, leaves it with two neighbours.
    xyz = np.array([[0, 0, 1], [0.25, 0, 1], [0, 0.5, 1]], np.float32)
    assert np.isnan(normals_and_curvature(xyz, np.array([0]), 0.5)[1]).all()
    assert np.isfinite(normals_and_curvature(xyz, np.array([0]), 0.500001)[1]).all()


@pytest.mark.parametrize(
    "xyz",
    [
        [[0, 0, 1], [0.001, 0, 1]],
        [[0, 0, 1], [0.002, 0, 1], [0.004, 0, 1]],
        [[0.1, 0.2, 1]] * 5,
        [[i * 0.001, i * 0.001, 1 + i * 0.001] for i in range(8)],
    ],
    ids=["two points", "three on a line", "one place", "a diagonal"],
)
def test_no_plane_no_normal(xyz):
    xyz = np.array(xyz, np.float32)
    normals, curvature = normals_and_curvature(xyz, np.arange(len(xyz)))
    assert np.isnan(normals).all()
    assert np.isnan(curvature).all()
    assert count_without_normal(xyz) == len(xyz)


def test_counts_what_would_have_no_normal(rng):
    lonely = rng.uniform(0.5, 3.0, (40, 3))
    pairs = np.repeat(rng.uniform(-3.0, -0.5, (10, 3)), 2, axis=0) + rng.uniform(0, 0.01, (20, 3))
    xyz = rng.permutation(np.concatenate([_bumpy(rng), lonely, pairs])).astype(np.float32)
    normals, _ = normals_and_curvature(xyz, np.arange(len(xyz)))
    assert count_without_normal(xyz) == np.count_nonzero(np.isnan(normals[:, 0])) >= 55


def test_nothing_asked_nothing_answered():
    normals, curvature = normals_and_curvature(np.zeros((0, 3), np.float32), np.zeros(0, np.int64))
    assert (normals.shape, curvature.shape) == ((0, 3), (0,))
    assert count_without_normal(np.zeros((0, 3), np.float32)) == 0
