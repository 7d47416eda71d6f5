# SPDX-License-Identifier: Apache-2.0
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

sys.path.insert(0, str(Path(__file__).parent))
from contact_builders import RADIUS, half_space, paraboloid, skin

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, ContactProblem, Layer, bed_stiffness, solve_winkler


def test_bed_without_lateral_strain_is_modulus_over_thickness():
    assert bed_stiffness(Layer(modulus_pa=3e6, poisson=0.0, thickness_m=0.002)) == pytest.approx(1.5e9)


def test_force_on_a_paraboloid_is_the_closed_form():
    depth = 2e-4  # F = π R k d² (Johnson 1985, section 4.3)
    solution = solve_winkler(paraboloid(256, 0.006, skin()), Command(depth_m=depth))
    assert_allclose(solution.force_n, math.pi * RADIUS * bed_stiffness(skin()) * depth**2, rtol=1e-3)


def test_hand_worked_bed():
    gap = np.array([[0.0, 1.0], [2.0, np.inf]]) * 1e-4
    layer = Layer(modulus_pa=1e6, poisson=0.0, thickness_m=0.001)  # k = 1e9 Pa/m
    problem = ContactProblem(gap, 1e-3, (layer,))
    solution = solve_winkler(problem, Command(force_n=0.2))  # 0.2 N = 1e3 N/m (d + d - 1e-4), d = 1.5e-4
    assert solution.depth_m == pytest.approx(1.5e-4)
    assert_allclose(solution.pressure, [[1.5e5, 0.5e5], [0.0, 0.0]], rtol=1e-12)
    assert solution.area_m2 == pytest.approx(2e-6)


@given(gap=arrays(np.float64, (5, 5), elements=st.floats(0, 1e-3)), force=st.floats(1e-6, 10))
def test_force_is_met_on_any_gap(gap, force):
    problem = ContactProblem(gap - gap.min(), 1e-3, (Layer(modulus_pa=1e6, poisson=0.3, thickness_m=0.01),))
    solution = solve_winkler(problem, Command(force_n=force))
    assert_allclose(solution.force_n, force, rtol=1e-9)
    again = solve_winkler(problem, Command(depth_m=solution.depth_m))
    assert_allclose(again.pressure, solution.pressure, rtol=1e-9, atol=1e-9)


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
