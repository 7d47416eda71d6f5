# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from contact_builders import RADIUS, grid, half_space, paraboloid, skin
from every_case import every_refusal
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch.simulation.contact.closed_form import bed_stiffness, solve_hertz, solve_winkler
from foretouch.simulation.contact.layer import solve_layer
from foretouch.simulation.contact.problem import Command, ContactProblem, Layer


def test_hertz_of_a_sphere_is_the_closed_form():
    depth = 1e-4
    solution = solve_hertz(paraboloid(25, 0.006), Command(depth_m=depth))
    force = 4 / 3 * half_space().plane_modulus_pa * math.sqrt(RADIUS) * depth**1.5
    assert_allclose(solution.force_n, force, rtol=1e-6)
    assert_allclose(solution.area_m2, math.pi * RADIUS * depth, rtol=1e-6)
    assert_allclose(solution.pressure.sum() * (0.006 / 25) ** 2, force, rtol=1e-12)
    assert_allclose(solution.displacement[0].max(), depth, rtol=1e-6)
    assert_allclose(solve_hertz(paraboloid(25, 0.006), Command(force_n=force)).depth_m, depth, rtol=1e-6)
    tiny = solve_hertz(paraboloid(24, 0.012), Command(force_n=1e-7))  # the footprint lies between cells
    assert_allclose(tiny.pressure.sum() * (0.012 / 24) ** 2, 1e-7, rtol=1e-12)


def test_hertz_of_an_ellipse_agrees_with_the_elastic_half_space_and_far_away_with_a_point_load():
    depth = 8e-5
    for ratio in (1.0, 2.0, 8.0):
        problem = paraboloid(96, 0.0036, ratio=ratio)
        closed = solve_hertz(problem, Command(depth_m=depth))
        solved = solve_layer(problem, Command(depth_m=depth), tolerance=1e-6)
        assert_allclose(closed.force_n, solved.force_n, rtol=0.006)
        assert_allclose(closed.area_m2, solved.area_m2, rtol=0.03)
        assert np.abs(closed.pressure - solved.pressure).sum() < 0.02 * solved.pressure.sum()
        if ratio == 1.0:
            assert_allclose(closed.displacement, solved.displacement, atol=0.01 * depth)
    x, y, step = grid(25, 0.006)
    away = np.hypot(x, y) > 1.5 * step
    for force in (1e-12, 1e-29):
        displacement = solve_hertz(paraboloid(25, 0.006), Command(force_n=force)).displacement[0]
        point_load = force / (math.pi * half_space().plane_modulus_pa * np.hypot(x, y)[away])  # Johnson, eq. 3.22b
        assert_allclose(displacement[away], point_load, rtol=1e-5)


def test_what_is_no_paraboloid_is_refused_by_hertz():
    x, y, step = grid(25, 0.012)
    round_gap = paraboloid(25, 0.012).gap
    gaps = [
        (x**2, r"flat or hollow|too close to the window's border"),
        (x**2 - 0.5 * y**2, r"flat or hollow|too close to the window's border"),
        (np.where(x > 1e-3, np.inf, round_gap), "an edge cuts the surface"),
        (paraboloid(25, 0.012, ratio=1e4).gap, "a line rather than an ellipse"),
        ((x + 0.01) ** 2 + y**2, "too close to the window's border"),
    ]

    def solve(gap):
        solve_hertz(ContactProblem(gap - gap.min(), step, (half_space(),)), Command(force_n=1.0))

    every_refusal(ContactError, [(rule, gap) for gap, rule in gaps], solve)


def test_force_of_a_bed_under_a_paraboloid_is_the_closed_form_and_beds_in_series_share_the_depth():
    depth = 2e-4  # F = π R k d² (Johnson 1985, section 4.3)
    solution = solve_winkler(paraboloid(256, 0.006, skin()), Command(depth_m=depth))
    assert_allclose(solution.force_n, math.pi * RADIUS * bed_stiffness(skin()) * depth**2, rtol=1e-3)
    soft = Layer(modulus_pa=1e5, poisson=0.0, thickness_m=0.01)
    problem = paraboloid(24, 0.012, skin(), soft)
    solution = solve_winkler(problem, Command(force_n=0.5))
    overlap = np.maximum(solution.depth_m - problem.gap, 0.0)
    assert_allclose(solution.displacement.sum(axis=0), overlap, atol=1e-15)
    first, second = solution.displacement
    assert_allclose(first * bed_stiffness(skin()), second * bed_stiffness(soft), rtol=1e-9)
    with pytest.raises(ContactError, match="a half-space has no Winkler bed"):
        solve_winkler(paraboloid(8, 0.01, half_space()), Command(force_n=1.0))
