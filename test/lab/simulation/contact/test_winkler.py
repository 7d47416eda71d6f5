# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from contact_builders import RADIUS, half_space, paraboloid, skin
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch_lab.simulation.contact.problem import Command, ElasticLayer, bed_stiffness, solve_winkler


def test_force_of_a_bed_under_a_paraboloid_is_the_closed_form_and_beds_in_series_share_the_depth():
    depth = 2e-4  # F = π R k d² (Johnson 1985, section 4.3)
    solution = solve_winkler(paraboloid(256, 0.006, skin()), Command(depth_m=depth))
    assert_allclose(solution.force_n, math.pi * RADIUS * bed_stiffness(skin()) * depth**2, rtol=1e-3)
    soft = ElasticLayer(modulus_pa=1e5, poisson=0.0, thickness_m=0.01)
    problem = paraboloid(24, 0.012, skin(), soft)
    solution = solve_winkler(problem, Command(force_n=0.5))
    overlap = np.maximum(solution.depth_m - problem.gap, 0.0)
    assert_allclose(solution.displacement.sum(axis=0), overlap, atol=1e-15)
    first, second = solution.displacement
    assert_allclose(first * bed_stiffness(skin()), second * bed_stiffness(soft), rtol=1e-9)
    with pytest.raises(ContactError, match="a half-space has no Winkler bed"):
        solve_winkler(paraboloid(8, 0.01, half_space()), Command(force_n=1.0))
