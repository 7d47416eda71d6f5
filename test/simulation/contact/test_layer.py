# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

sys.path.insert(0, str(Path(__file__).parent))
from contact_builders import RADIUS, grid, half_space, paraboloid, skin
from finite_elements import press, surface_compliance

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, ContactConfig, ContactProblem, Layer, solve_layer


def hertz_force(layer, depth, radius=RADIUS):
    return 4 / 3 * layer.plane_modulus_pa * math.sqrt(radius) * depth**1.5


def dimitriadis_force(layer, depth, radius=RADIUS):
    """Dimitriadis et al. 2002, eqs. 12 and 15: a sample bonded to its base."""
    nu, pi = layer.poisson, math.pi
    a0 = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b0 = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    chi = math.sqrt(radius * depth) / layer.thickness_m
    series = 1 - 2 * a0 / pi * chi + 4 * a0**2 / pi**2 * chi**2
    series -= 8 / pi**3 * (a0**3 + 4 * pi**2 / 15 * b0) * chi**3
    series += 16 * a0 / pi**4 * (a0**3 + 3 * pi**2 / 5 * b0) * chi**4
    return hertz_force(layer, depth, radius) * series


@pytest.mark.parametrize("relative_depth", [1e-4, 1e-2, 1e-1])
def test_force_is_that_of_hertz(relative_depth):
    depth = relative_depth * RADIUS
    problem = paraboloid(48, 2.6 * math.sqrt(RADIUS * depth))
    assert_allclose(solve_layer(problem, Command(depth_m=depth)).force_n, hertz_force(half_space(), depth), rtol=0.01)


def test_pressure_is_that_of_hertz():
    depth = 1e-4
    problem = paraboloid(64, 2.6 * math.sqrt(RADIUS * depth))
    solution = solve_layer(problem, Command(depth_m=depth), ContactConfig(tolerance=1e-8))
    peak = 2 * half_space().plane_modulus_pa / math.pi * math.sqrt(depth / RADIUS)
    assert_allclose(solution.pressure.max(), peak, rtol=0.005)
    assert_allclose(solution.area_m2, math.pi * RADIUS * depth, rtol=0.03)  # counted in whole cells


def test_force_of_a_flat_punch_is_that_of_sneddon():
    radius, depth = 0.003, 1e-4
    x, y, step = grid(64, 2.2 * radius)
    problem = ContactProblem(np.where(np.hypot(x, y) <= radius, 0.0, np.inf), step, (half_space(),))
    expected = 2 * radius * half_space().plane_modulus_pa * depth
    assert_allclose(solve_layer(problem, Command(depth_m=depth)).force_n, expected, rtol=0.01)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.5])
@pytest.mark.parametrize("thickness", [0.02, 0.01, 0.005, 0.003])
def test_force_on_a_thin_layer_is_that_of_dimitriadis(poisson, thickness):
    layer = Layer(modulus_pa=1e6, poisson=poisson, thickness_m=thickness)
    depth = 1e-4
    problem = paraboloid(48, 2.6 * math.sqrt(RADIUS * depth), layer)
    assert_allclose(solve_layer(problem, Command(depth_m=depth)).force_n, dimitriadis_force(layer, depth), rtol=0.05)


@pytest.mark.parametrize("poisson", [0.0, 0.316, 0.45])
def test_agrees_with_finite_elements(poisson):
    layer = Layer(modulus_pa=1e6, poisson=poisson, thickness_m=0.002)
    depth = 1.5e-4
    r = np.concatenate([np.linspace(0, 0.0025, 41), 0.0025 + 0.0075 * np.linspace(0, 1, 25)[1:] ** 1.5])
    forces = press(surface_compliance(1e6, poisson, r, np.linspace(0, 0.002, 25)), r**2 / (2 * RADIUS), depth)
    solution = solve_layer(paraboloid(48, 0.005, layer), Command(depth_m=depth))
    assert_allclose(solution.force_n, forces.sum(), rtol=0.015)


def test_given_force_and_depth_are_two_ways_to_the_same_contact():
    problem = paraboloid(32, 0.008, skin(), Layer(modulus_pa=1e5, poisson=0.3, thickness_m=0.02))
    tight = ContactConfig(tolerance=1e-9)
    at_force = solve_layer(problem, Command(force_n=1.5), tight)
    at_depth = solve_layer(problem, Command(depth_m=at_force.depth_m), tight)
    assert_allclose(at_depth.force_n, 1.5, rtol=1e-6)
    assert_allclose(at_depth.pressure, at_force.pressure, atol=1e-5 * at_force.pressure.max())


@pytest.mark.parametrize("force", [1e-9, 1e-3, 1.0, 5.0])
def test_pressure_sums_to_the_force(force):
    problem = paraboloid(24, 0.012, skin())
    solution = solve_layer(problem, Command(force_n=force))
    assert_allclose(solution.pressure.sum() * problem.cell_m2, force, rtol=1e-12)


def test_surfaces_meet_under_pressure_and_never_pass_through_each_other():
    rng = np.random.default_rng(0)
    rough = rng.random((32, 32)) * 1e-4
    problem = ContactProblem(rough - rough.min(), 3e-4, (skin(),))
    solution = solve_layer(problem, Command(force_n=3.0), ContactConfig(tolerance=1e-8))
    distance = solution.displacement.sum(axis=0) + problem.gap - solution.depth_m
    assert 0.05 < np.mean(solution.pressure > 0) < 0.95
    assert solution.pressure.min() == 0.0
    assert distance.min() > -1e-5 * solution.depth_m
    assert_allclose(distance[solution.pressure > 0], 0.0, atol=1e-5 * solution.depth_m)


def test_turning_the_gap_turns_the_pressure():
    problem = paraboloid(24, 0.012, skin(), ratio=3.0)
    turned = ContactProblem(problem.gap.T.copy(), problem.step_m, problem.layers)
    tight = ContactConfig(tolerance=1e-9)
    straight = solve_layer(problem, Command(force_n=2.0), tight).pressure
    assert_allclose(solve_layer(turned, Command(force_n=2.0), tight).pressure, straight.T, atol=1e-6 * straight.max())


def test_answer_does_not_depend_on_the_window_around_it():
    small, large = paraboloid(24, 0.006, skin()), paraboloid(48, 0.012, skin())
    tight = ContactConfig(tolerance=1e-9)
    inner = solve_layer(small, Command(force_n=0.5), tight).pressure
    outer = solve_layer(large, Command(force_n=0.5), tight).pressure
    assert not inner[0].any()
    assert_allclose(outer[12:36, 12:36], inner, atol=1e-5 * inner.max())


def test_layers_share_the_depth_by_their_softness():
    same = Layer(modulus_pa=1e6, poisson=0.3)
    solution = solve_layer(paraboloid(24, 0.006, same, same), Command(force_n=0.5))
    assert_allclose(solution.displacement[0], solution.displacement[1], rtol=1e-12)


HARD_GAPS = {
    "flat": np.zeros((24, 24)),
    "one cell": np.pad([[0.0]], ((3, 20), (3, 20)), constant_values=np.inf),
    "spike": np.pad([[0.0]], ((10, 13), (12, 11)), constant_values=1e-3),
    "corner": np.pad([[0.0, 1e-5]], ((0, 23), (0, 22)), constant_values=np.inf),
    "holes": np.where(np.random.default_rng(0).random((24, 24)) < 0.5, np.inf, 0.0),
    "two islands": np.where(np.abs(np.arange(24) - 11.5) > 8, 0.0, 1e-4) * np.ones((24, 1)),
}


@pytest.mark.parametrize("modulus", [1e2, 1e6, 1e12])
@pytest.mark.parametrize("name", HARD_GAPS)
def test_hard_cases_converge(name, modulus):
    for layer in (
        half_space(modulus),
        half_space(modulus, 0.5),
        Layer(modulus_pa=modulus, poisson=0.3, thickness_m=0.003),
    ):
        problem = ContactProblem(HARD_GAPS[name], 5e-4, (layer,))
        for command in (Command(force_n=1e-8 * modulus), Command(force_n=1e-6 * modulus), Command(depth_m=2e-4)):
            try:
                solution = solve_layer(problem, command)
            except ContactError as err:  # a single cell may well be pressed through, and must say so
                assert "compressed by" in str(err)  # noqa: PT017
                continue
            distance = solution.displacement.sum(axis=0) + problem.gap - solution.depth_m
            assert distance.min() > -0.021 * solution.depth_m
            assert solution.force_n == pytest.approx(command.force_n or solution.force_n, rel=1e-9)


@pytest.mark.parametrize("command", [Command(force_n=0.0), Command(depth_m=0.0), Command(depth_m=-1e-3)])
def test_no_push_is_no_pressure(command):
    solution = solve_layer(paraboloid(16, 0.01, skin()), command)
    assert not solution.pressure.any()
    assert not solution.displacement.any()
    assert solution.force_n == solution.area_m2 == 0.0


def test_grazing_contact_is_small_and_finite():
    solution = solve_layer(paraboloid(16, 0.01, skin()), Command(depth_m=1e-12))
    assert 0.0 < solution.force_n < 1e-6
    assert np.isfinite(solution.pressure).all()


def test_pressing_through_the_skin_is_refused():
    with pytest.raises(ContactError, match=r"layers\[0\]: compressed by .* max_strain 0.95: press less"):
        solve_layer(paraboloid(24, 0.012, skin()), Command(force_n=1e4))


def test_depth_beyond_the_window_is_refused():
    with pytest.raises(ContactError, match=r"more than the 0\.012 m window is wide"):
        solve_layer(paraboloid(24, 0.012), Command(force_n=1e6))


def test_too_few_iterations_are_told_with_their_counts():
    with pytest.raises(ContactError, match=r"no convergence after 4 iterations on 24\^2 cells, \d+ of them in contact"):
        solve_layer(paraboloid(24, 0.012, skin()), Command(force_n=1.0), ContactConfig(max_iterations=2))


def test_layer_thinner_than_half_a_cell_is_refused():
    with pytest.raises(ContactError, match=r"less than half a cell, .* use the Winkler level"):
        solve_layer(paraboloid(12, 0.012, skin(0.0002)), Command(force_n=1.0))
