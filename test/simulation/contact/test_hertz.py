# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

sys.path.insert(0, str(Path(__file__).parent))
from contact_builders import RADIUS, grid, half_space, paraboloid

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, ContactConfig, ContactProblem, solve_hertz, solve_layer


def test_sphere_is_the_closed_form():
    depth = 1e-4
    solution = solve_hertz(paraboloid(25, 0.006), Command(depth_m=depth))
    force = 4 / 3 * half_space().plane_modulus_pa * math.sqrt(RADIUS) * depth**1.5
    assert_allclose(solution.force_n, force, rtol=1e-6)
    assert_allclose(solution.area_m2, math.pi * RADIUS * depth, rtol=1e-6)
    assert_allclose(solution.pressure.sum() * (0.006 / 25) ** 2, force, rtol=1e-12)
    assert_allclose(solution.displacement[0].max(), depth, rtol=1e-6)


def test_force_and_depth_are_inverse():
    problem = paraboloid(24, 0.006, ratio=4.0)
    depth = solve_hertz(problem, Command(force_n=0.7)).depth_m
    assert_allclose(solve_hertz(problem, Command(depth_m=depth)).force_n, 0.7, rtol=1e-9)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 8.0])
def test_ellipse_agrees_with_the_elastic_half_space(ratio):
    problem = paraboloid(96, 0.0036, ratio=ratio)
    depth = 8e-5
    closed = solve_hertz(problem, Command(depth_m=depth))
    solved = solve_layer(problem, Command(depth_m=depth), ContactConfig(tolerance=1e-6))
    assert_allclose(closed.force_n, solved.force_n, rtol=0.006)
    assert_allclose(closed.area_m2, solved.area_m2, rtol=0.03)
    assert np.abs(closed.pressure - solved.pressure).sum() < 0.02 * solved.pressure.sum()


def test_displacement_beside_the_contact_agrees_with_the_half_space():
    problem = paraboloid(96, 0.006)
    closed = solve_hertz(problem, Command(depth_m=1e-4)).displacement
    solved = solve_layer(problem, Command(depth_m=1e-4)).displacement
    assert_allclose(closed, solved, atol=0.01 * 1e-4)


def test_footprint_smaller_than_a_cell_keeps_its_force():
    problem = paraboloid(24, 0.012)
    solution = solve_hertz(problem, Command(force_n=1e-7))
    assert_allclose(solution.pressure.sum() * problem.cell_m2, 1e-7, rtol=1e-12)


def test_saddle_and_plane_are_refused():
    for ratio in (0.0, -0.5):
        x, y, step = grid(24, 0.012)
        gap = x**2 + ratio * y**2
        with pytest.raises(ContactError, match=r"flat or hollow|too close to the window's border"):
            solve_hertz(ContactProblem(gap - gap.min(), step, (half_space(),)), Command(force_n=1.0))


def test_edge_through_first_touch_is_refused():
    problem = paraboloid(25, 0.012)
    gap = np.where(grid(25, 0.012)[0] > 1e-3, np.inf, problem.gap)
    with pytest.raises(ContactError, match="an edge cuts the surface"):
        solve_hertz(ContactProblem(gap, problem.step_m, problem.layers), Command(force_n=1.0))


def test_line_contact_is_refused():
    with pytest.raises(ContactError, match="a line rather than an ellipse"):
        solve_hertz(paraboloid(25, 0.012, ratio=1e4), Command(force_n=1.0))


@pytest.mark.parametrize("force", [1e-12, 1e-20, 1e-29])
def test_beside_a_tiny_footprint_the_surface_moves_as_under_a_point_load(force):
    x, y, step = grid(25, 0.006)
    problem = paraboloid(25, 0.006)
    displacement = solve_hertz(problem, Command(force_n=force)).displacement[0]
    away = np.hypot(x, y) > 1.5 * step
    point_load = force / (math.pi * half_space().plane_modulus_pa * np.hypot(x, y)[away])  # Johnson 1985, eq. 3.22b
    assert_allclose(displacement[away], point_load, rtol=1e-5)
