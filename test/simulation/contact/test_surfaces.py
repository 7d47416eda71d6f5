# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from foretouch.simulation.contact.pad import bent_surface, tilted, wedge

X, Y = np.meshgrid(np.linspace(-0.005, 0.005, 11), np.linspace(-0.005, 0.005, 11))


def test_a_cylinder_is_straight_along_its_axis():
    height = bent_surface(X, Y, 1 / 0.03, 0.0)
    assert_allclose(height, np.broadcast_to(height[0], height.shape))
    assert_allclose(height[0, 0], -(0.005**2) / 0.06)


def test_turning_by_a_right_angle_swaps_the_curvatures():
    assert_allclose(bent_surface(X, Y, 20.0, 5.0, np.pi / 2), bent_surface(X, Y, 5.0, 20.0), atol=1e-18)


def test_wedge_falls_behind_its_edge_only():
    height = wedge(X, Y, 2.0)
    assert_allclose(height[0], -2.0 * np.maximum(X[0], 0.0))
    assert np.isneginf(wedge(X, Y, np.inf)[X > 0]).all()


def test_rounded_wedge_meets_both_flanks_smoothly():
    line = np.linspace(-0.002, 0.002, 401)
    height = wedge(line, 0 * line, 1.0, rounding_m=0.001)
    assert_allclose(height[[0, -1]], [0.0, -0.002], atol=1e-12)
    assert np.abs(np.diff(height, 2)).max() <= 1.01 * (line[1] - line[0]) ** 2 / 0.001


def test_tilt_is_a_plane():
    assert_allclose(tilted(np.zeros_like(X), X, Y, 0.1, -0.2), 0.1 * X - 0.2 * Y)
