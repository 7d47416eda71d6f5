# SPDX-License-Identifier: Apache-2.0
"""Electrode layout: mirrored, radial."""

import numpy as np
from numpy.testing import assert_allclose

from foretouch.tactile.layout import electrode_normals, electrode_positions


def test_positions_are_metres_and_mirrored() -> None:
    positions = electrode_positions()
    assert positions.shape == (24, 3)
    assert_allclose(positions[0], [0.00982, -0.00398, -0.00277], atol=1e-12)
    assert_allclose(positions[10:20], positions[:10] * [1, -1, 1])
    assert_allclose(positions[21] * [1, -1, 1], positions[22])
    assert len(np.unique(positions, axis=0)) == 24


def test_normals_are_radial_and_point_to_the_pad() -> None:
    positions, normals = electrode_positions(), electrode_normals()
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert_allclose(np.cross(normals, positions * [0, 1, 1]), 0.0, atol=1e-15)
    assert np.all(normals[:, 2] < 0)
    assert_allclose(normals[20], [0, 0, -1])
