# SPDX-License-Identifier: Apache-2.0
"""Voxel grid, normals and outlier removal against plain definitions; test/kernels compares them with NumPy."""

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.geometry.columns import bounds, centred_columns, distances, quantiles, spread
from foretouch.cloud.geometry.pcl_filters import (
    cell_means,
    count_without_normal,
    inlier_mask,
    mean_neighbour_distance,
    normals_and_curvature,
    voxel_grid,
)
from foretouch.errors import CloudError


def test_nan_spreads_to_its_cell_and_column_only_and_too_many_cells_are_refused():
    voxels = voxel_grid(np.array([[0.9, 0, 0], [1.1, 0, 0], [1.9, 0, 0], [-0.1, 0, 0]], np.float32), 1.0)
    mean = cell_means(np.array([[4.0, 5.0], [np.nan, 1.0], [2.0, 3.0], [0.0, 0.0]]), voxels)
    np.testing.assert_array_equal(mean, [[0.0, 0.0], [4.0, 5.0], [np.nan, 2.0]])
    with pytest.raises(CloudError, match="too many to number"):
        voxel_grid(np.array([[0, 0, 0], [1e30, 1e30, 1e30]], np.float32), 0.01)


def test_normals_look_at_the_sensor_and_neighbours_are_strictly_within_the_radius(rng):
    x, y = rng.uniform(-0.08, 0.08, (2, 1500))
    z = 1.0 + 5.0 * x**2 + 0.01 * np.sin(60 * y) + rng.normal(0, 0.001, 1500)
    xyz = np.column_stack([x, y, z]).astype(np.float32)
    query = np.arange(0, len(xyz), 10)
    normals, _ = normals_and_curvature(xyz, query)
    assert (np.einsum("ij,ij->i", normals, xyz[query]) <= 0.0).all()
    # Three points around the first: one on the limit, exactly representable, leaves it with two neighbours.
    xyz = np.array([[0, 0, 1], [0.25, 0, 1], [0, 0.5, 1]], np.float32)
    assert np.isnan(normals_and_curvature(xyz, np.array([0]), 0.5)[1]).all()
    assert np.isfinite(normals_and_curvature(xyz, np.array([0]), 0.500001)[1]).all()


def test_empty_and_tiny_clouds():
    none = np.zeros((0, 3), np.float32)
    normals, curvature = normals_and_curvature(none, np.zeros(0, np.int64))
    assert (normals.shape, curvature.shape) == ((0, 3), (0,))
    assert count_without_normal(none) == 0
    assert cell_means(np.zeros((0, 3)), voxel_grid(none, 0.01)).shape == (0, 3)
    for n in range(4):
        assert inlier_mask(np.eye(3, dtype=np.float32)[:n]).shape == (min(n, 3),)
        assert inlier_mask(np.ones((n, 3), np.float32)).all()
        np.testing.assert_array_equal(mean_neighbour_distance(np.ones((n, 3), np.float32), 50), np.zeros(n))


def test_an_outlier_is_dropped_and_distances_and_quantiles_are_those_of_numpy(rng):
    line = np.column_stack([np.arange(60) * 0.001, np.zeros(60), np.ones(60)])
    assert not inlier_mask(np.concatenate([line, [[0.5, 0.5, 1.0]]]).astype(np.float32))[-1]

    def check(count):
        points = rng.normal(size=(count, 3)) * 0.1 + [0.0, 0.1, 1.2]
        centre, columns, covariance = centred_columns(points)
        np.testing.assert_array_equal(centre, points.mean(axis=0))
        np.testing.assert_array_equal(columns.T, points - centre)
        np.testing.assert_allclose(covariance, columns @ columns.T / count, rtol=1e-12, atol=1e-18)
        some = points.astype(np.float32)
        some[::5, count % 3], some[1::7, 0] = np.nan, np.inf
        finite = some[np.isfinite(some).all(axis=1)]
        low = finite.min(axis=0, initial=np.inf), finite.max(axis=0, initial=-np.inf)
        np.testing.assert_array_equal(bounds(some), low)
        np.testing.assert_array_equal(distances(columns), np.sqrt(((points - centre) ** 2).sum(axis=1)))
        tied = np.where(np.arange(count) % 2, points[:, 0], points[0, 0])
        for shares in ((0.02, 0.98), (0.25, 0.5, 0.75, 0.98), (0.0, 1.0)):
            for values in (points[:, 0].copy(), tied):
                np.testing.assert_array_equal(quantiles(values, shares), np.quantile(values, shares))
        for n in (count + 2, 7 * count + 3):
            places = np.linspace(0.0, n - 1.0, count + 1).astype(np.intp)
            np.testing.assert_array_equal(spread(n, count + 1), places)

    every_case([1, 2, 8, 129, 999, 1000, 3001], check)
