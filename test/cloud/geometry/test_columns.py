# SPDX-License-Identifier: Apache-2.0
"""Mean, distances and quantiles by columns are NumPy's to the last bit."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from foretouch.cloud.geometry.columns import centred_columns, distances, quantiles


@pytest.mark.parametrize("count", [1, 8, 129, 3001])
def test_mean_and_distances_are_those_of_rows(count: int, rng) -> None:
    points = rng.normal(size=(count, 3)) * 0.1 + [0.0, 0.1, 1.2]
    centre, columns = centred_columns(points)
    assert_array_equal(centre, points.mean(axis=0))
    assert_array_equal(columns.T, points - centre)
    assert_array_equal(distances(columns), np.sqrt(((points - centre) ** 2).sum(axis=1)))


@pytest.mark.parametrize("count", [1, 2, 8, 999, 1000])
@pytest.mark.parametrize("shares", [(0.02, 0.98), (0.25, 0.5, 0.75, 0.98), (0.0, 1.0)])
def test_quantiles_are_those_of_numpy(count: int, shares: tuple[float, ...], rng) -> None:
    values = rng.normal(size=count)
    assert_array_equal(quantiles(values, shares), np.quantile(values, shares))
    values[::2] = values[0]
    assert_array_equal(quantiles(values, shares), np.quantile(values, shares))
