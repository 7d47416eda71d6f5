# SPDX-License-Identifier: Apache-2.0
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

sys.path.insert(0, str(Path(__file__).parent))
from contact_builders import RADIUS, half_space, paraboloid, skin

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, Layer, bed_stiffness, solve_winkler


def test_force_on_a_paraboloid_is_the_closed_form():
    depth = 2e-4  # F = π R k d² (Johnson 1985, section 4.3)
    solution = solve_winkler(paraboloid(256, 0.006, skin()), Command(depth_m=depth))
    assert_allclose(solution.force_n, math.pi * RADIUS * bed_stiffness(skin()) * depth**2, rtol=1e-3)


def test_beds_in_series_share_the_depth():
    soft = Layer(modulus_pa=1e5, poisson=0.0, thickness_m=0.01)
    problem = paraboloid(24, 0.012, skin(), soft)
    solution = solve_winkler(problem, Command(force_n=0.5))
    overlap = np.maximum(solution.depth_m - problem.gap, 0.0)
    assert_allclose(solution.displacement.sum(axis=0), overlap, atol=1e-15)
    assert_allclose(
        solution.displacement[0] * bed_stiffness(skin()), solution.displacement[1] * bed_stiffness(soft), rtol=1e-9
    )


def test_no_push_is_no_pressure_and_too_much_is_refused():
    assert not solve_winkler(paraboloid(8, 0.01, skin()), Command(force_n=0.0)).pressure.any()
    with pytest.raises(ContactError, match="a half-space has no Winkler bed"):
        solve_winkler(paraboloid(8, 0.01, half_space()), Command(force_n=1.0))
    with pytest.raises(ContactError, match=r"layers\[0\]: compressed by .* of its 1.5 mm"):
        solve_winkler(paraboloid(24, 0.012, skin()), Command(force_n=200.0))
