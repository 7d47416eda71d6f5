# SPDX-License-Identifier: Apache-2.0
"""Distances from the nearest point, compiled and by NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch import kernels
from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.models.network.length_check import _nearest
from foretouch.models.network.preparation import PreparedCloud


@pytest.mark.parametrize("count", [1, 15, 16, 750])
def test_they_differ_by_the_rounding_of_numpy(count: int, rng) -> None:
    points = rng.normal(size=(count, 6)).astype(np.float32) / 3.0
    prepared = PreparedCloud(points, UnitSphereFrame(np.zeros(3), 0.1))
    targets = np.concatenate([rng.normal(size=(40, 3)) * 0.05, 0.1 * points[:1, :3], [[1e3, 0.0, 0.0]]])
    compiled = _nearest(prepared, targets)
    exact = np.linalg.norm(targets[:, None] - 0.1 * points[:, :3].astype(np.float64), axis=2).min(axis=1)
    assert_allclose(compiled, exact, rtol=1e-6, atol=1e-8)
    with kernels.disabled():
        assert_allclose(compiled, _nearest(prepared, targets), rtol=1e-4, atol=1e-4)
    assert _nearest(prepared, targets[:0]).shape == (0,)
