# SPDX-License-Identifier: Apache-2.0
"""Mean, distances and quantiles by columns are NumPy's to the last bit."""

import numpy as np
from every_case import every_case
from numpy.testing import assert_array_equal

from foretouch.cloud.geometry.columns import centred_columns, distances, quantiles


def test_mean_distances_and_quantiles_are_those_of_numpy(rng) -> None:
    def check(count: int) -> None:
        points = rng.normal(size=(count, 3)) * 0.1 + [0.0, 0.1, 1.2]
        centre, columns = centred_columns(points)
        assert_array_equal(centre, points.mean(axis=0))
        assert_array_equal(columns.T, points - centre)
        assert_array_equal(distances(columns), np.sqrt(((points - centre) ** 2).sum(axis=1)))
        tied = np.where(np.arange(count) % 2, points[:, 0], points[0, 0])
        for shares in ((0.02, 0.98), (0.25, 0.5, 0.75, 0.98), (0.0, 1.0)):
            for values in (points[:, 0].copy(), tied):
                assert_array_equal(quantiles(values, shares), np.quantile(values, shares))

    every_case([1, 2, 8, 129, 999, 1000, 3001], check)
