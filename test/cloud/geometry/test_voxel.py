# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.geometry.voxel import voxel_grid
from foretouch.errors import CloudError


def test_cells_stand_on_the_origin_and_not_on_the_cloud():
    grid = voxel_grid(np.array([[0.9, 0, 0], [1.1, 0, 0], [1.9, 0, 0], [-0.1, 0, 0]], np.float32), 1.0)
    np.testing.assert_array_equal(grid.cell, [1, 2, 2, 0])
    np.testing.assert_array_equal(grid.counts, [1, 1, 2])


def test_cells_are_ordered_x_then_y_then_z():
    xyz = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0]], np.float32) + np.float32(0.5)
    np.testing.assert_array_equal(voxel_grid(xyz, 1.0).cell, [3, 2, 1, 0])


def test_mean_agrees_with_a_dictionary_of_cells(rng):
    xyz = rng.uniform(-0.1, 0.1, (500, 3)).astype(np.float32)
    values = rng.normal(size=(500, 4))
    grid = voxel_grid(xyz, 0.03)
    cells: dict[tuple[int, ...], list[int]] = {}
    for i, key in enumerate(np.floor(xyz.astype(float) / 0.03).astype(int)):
        cells.setdefault(tuple(key[::-1]), []).append(i)
    expected = [values[cells[key]].mean(axis=0) for key in sorted(cells)]
    np.testing.assert_allclose(grid.mean(values), expected, atol=1e-12)


def test_nan_spreads_to_its_cell_and_column_only():
    grid = voxel_grid(np.array([[0.1, 0, 0], [0.2, 0, 0], [1.5, 0, 0]], np.float32), 1.0)
    mean = grid.mean(np.array([[np.nan, 1.0], [2.0, 3.0], [4.0, 5.0]]))
    np.testing.assert_array_equal(mean, [[np.nan, 2.0], [4.0, 5.0]])


def test_an_empty_cloud_has_no_cells():
    grid = voxel_grid(np.zeros((0, 3), np.float32), 0.01)
    assert grid.mean(np.zeros((0, 3))).shape == (0, 3)


def test_too_many_cells_are_refused():
    with pytest.raises(CloudError, match="too many to number"):
        voxel_grid(np.array([[0, 0, 0], [1e30, 1e30, 1e30]], np.float32), 0.01)
