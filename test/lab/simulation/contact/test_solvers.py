# SPDX-License-Identifier: Apache-2.0
"""Both solvers against closed forms and hard gaps, and the pad that they press."""

import math
from itertools import product

import numpy as np
import pytest
from contact_builders import RADIUS, grid, half_space, paraboloid, press, rounded_edge, skin
from every_case import every_case
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from foretouch.errors import ContactError
from foretouch.tactile import BIOTAC_SP
from foretouch_lab.simulation.contact import layer as module
from foretouch_lab.simulation.contact.layer import solve_layer
from foretouch_lab.simulation.contact.pad import PadConfig, contact_frame, gap_field, pad_direction, pad_window
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer, bed_stiffness, solve_winkler
from foretouch_lab.simulation.fingertip import ThumbConfig, draw_finger, read_contact

PAD = PadConfig()
FINGER = draw_finger(ThumbConfig(), np.random.default_rng(0))


@pytest.fixture
def tight(monkeypatch):
    monkeypatch.setattr(module, "TOLERANCE", 1e-9)


def test_influence_is_that_of_a_winkler_bed_for_long_waves_and_of_a_half_space_for_short_ones():
    for poisson in (0.0, 0.3, 0.45):
        assert_allclose(module._layer_transfer([20.0, 1e3, 1e6], poisson), 1.0, rtol=1e-12)
        t, layer = 1e-4, ElasticLayer(modulus_pa=2e6, poisson=poisson, thickness_m=0.003)
        compliance = 2.0 * layer.thickness_m / (layer.plane_modulus_pa * t) * module._layer_transfer(t, poisson)
        assert_allclose(compliance, 1.0 / bed_stiffness(layer), rtol=1e-6)
    for thickness in (0.0005, 0.003):
        layer = ElasticLayer(modulus_pa=1e6, poisson=0.3, thickness_m=thickness)
        quarter = module._layer_influence(layer, 80, 5e-4)
        total = 4 * quarter[1:, 1:].sum() + 2 * quarter[0, 1:].sum() + 2 * quarter[1:, 0].sum() + quarter[0, 0]
        assert_allclose(total, 1.0 / bed_stiffness(layer), rtol=0.01)
    thick = module._layer_influence(ElasticLayer(modulus_pa=1e6, poisson=0.3, thickness_m=10.0), 16, 5e-4)
    assert_allclose(thick, module._layer_influence(half_space(), 16, 5e-4), rtol=0.01)
    with pytest.raises(ContactError, match=r"less than half a cell, .* use the Winkler level"):
        module._layer_influence(skin(0.0002), 12, 0.001)


def hertz_force(layer, depth):
    return 4 / 3 * layer.plane_modulus_pa * math.sqrt(RADIUS) * depth**1.5


def hertz_ellipse_force(layer, depth, ratio):
    """Johnson 1985, eqs. 4.26 to 4.28, for the gap (x² + ratio y²) / 2R; b/a from eq. 4.26 by bisection."""

    def curvatures(b_over_a):
        k, e = ellipk(1 - b_over_a**2), ellipe(1 - b_over_a**2)
        return (e / b_over_a**2 - k) / (k - e)

    b_over_a = brentq(lambda one: curvatures(one) - ratio, 1e-3, 1 - 1e-6)
    k, e = ellipk(1 - b_over_a**2), ellipe(1 - b_over_a**2)
    d, curvature = (k - e) / (1 - b_over_a**2), 1 / (2 * RADIUS)
    a = math.sqrt(depth * d / (curvature * k))
    return 2 * math.pi * layer.plane_modulus_pa * curvature * a**3 / (3 * d)


def dimitriadis_force(layer, depth):
    """Dimitriadis et al. 2002, eqs. 12 and 15: a sample bonded to its base."""
    nu, pi = layer.poisson, math.pi
    a0 = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b0 = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    chi = math.sqrt(RADIUS * depth) / layer.thickness_m
    series = 1 - 2 * a0 / pi * chi + 4 * a0**2 / pi**2 * chi**2
    series -= 8 / pi**3 * (a0**3 + 4 * pi**2 / 15 * b0) * chi**3
    series += 16 * a0 / pi**4 * (a0**3 + 3 * pi**2 / 5 * b0) * chi**4
    return hertz_force(layer, depth) * series


def test_forces_are_those_of_hertz_with_his_pressure_of_sneddon_and_of_dimitriadis(tight):
    for depth in (1e-6, 1e-4, 1e-3):
        found = solve_layer(paraboloid(64, 2.6 * math.sqrt(RADIUS * depth)), Command(depth_m=depth))
        assert_allclose(found.force_n, hertz_force(half_space(), depth), rtol=0.01)
        peak = 2 * half_space().plane_modulus_pa / math.pi * math.sqrt(depth / RADIUS)
        assert_allclose(found.pressure.max(), peak, rtol=0.01)
        assert_allclose(found.area_m2, math.pi * RADIUS * depth, rtol=0.03)  # counted in whole cells
    for ratio in (2.0, 8.0):
        solved = solve_layer(paraboloid(96, 0.0036, ratio=ratio), Command(depth_m=8e-5))
        assert_allclose(solved.force_n, hertz_ellipse_force(half_space(), 8e-5, ratio), rtol=0.006)
    radius, depth = 0.003, 1e-4
    x, y, step = grid(64, 2.2 * radius)
    punch = ContactProblem(np.where(np.hypot(x, y) <= radius, 0.0, np.inf), step, (half_space(),))
    expected = 2 * radius * half_space().plane_modulus_pa * depth
    assert_allclose(solve_layer(punch, Command(depth_m=depth)).force_n, expected, rtol=0.01)

    def check(poisson, thickness):
        layer = ElasticLayer(modulus_pa=1e6, poisson=poisson, thickness_m=thickness)
        problem = paraboloid(48, 2.6 * math.sqrt(RADIUS * depth), layer)
        found = solve_layer(problem, Command(depth_m=depth)).force_n
        assert_allclose(found, dimitriadis_force(layer, depth), rtol=0.05)

    every_case(product((0.0, 0.3, 0.45, 0.5), (0.02, 0.01, 0.005, 0.003)), check)


def test_force_and_depth_are_two_ways_to_a_contact_that_turns_with_its_gap_and_depends_on_no_window(tight):
    problem = paraboloid(32, 0.008, skin(), ElasticLayer(modulus_pa=1e5, poisson=0.3, thickness_m=0.02))
    at_force = solve_layer(problem, Command(force_n=1.5))
    at_depth = solve_layer(problem, Command(depth_m=at_force.depth_m))
    assert_allclose(at_depth.force_n, 1.5, rtol=1e-6)
    assert_allclose(at_depth.pressure, at_force.pressure, atol=1e-5 * at_force.pressure.max())
    problem = paraboloid(24, 0.012, skin(), ratio=3.0)
    turned = ContactProblem(problem.gap.T.copy(), problem.step_m, problem.layers)
    straight = solve_layer(problem, Command(force_n=2.0)).pressure
    assert_allclose(solve_layer(turned, Command(force_n=2.0)).pressure, straight.T, atol=1e-6 * straight.max())
    small, large = paraboloid(24, 0.006, skin()), paraboloid(48, 0.012, skin())
    inner, outer = (solve_layer(one, Command(force_n=0.5)).pressure for one in (small, large))
    assert_allclose(outer[12:36, 12:36], inner, atol=1e-5 * inner.max())


def test_hard_gaps_converge_and_surfaces_never_pass_through_each_other(rng, monkeypatch):
    gaps = {
        "flat": np.zeros((24, 24)),
        "rough": rng.permutation(576).reshape(24, 24) * 2e-7,
        "one cell": np.pad([[0.0]], ((3, 20), (3, 20)), constant_values=np.inf),
        "spike": np.pad([[0.0]], ((10, 13), (12, 11)), constant_values=1e-3),
        "corner": np.pad([[0.0, 1e-5]], ((0, 23), (0, 22)), constant_values=np.inf),
        "holes": np.where(rng.random((24, 24)) < 0.5, np.inf, 0.0),
        "two islands": np.where(np.abs(np.arange(24) - 11.5) > 8, 0.0, 1e-4) * np.ones((24, 1)),
    }

    def check(_name, gap, layer):
        problem, modulus = ContactProblem(gap, 5e-4, (layer,)), layer.modulus_pa
        for command in (Command(force_n=1e-8 * modulus), Command(force_n=1e-6 * modulus), Command(depth_m=2e-4)):
            try:
                solution = solve_layer(problem, command)
            except ContactError as err:  # a single cell may well be pressed through, and must say so
                assert "compressed by" in str(err)  # noqa: PT017
                continue
            distance = solution.displacement.sum(axis=0) + problem.gap - solution.depth_m
            assert solution.pressure.min() >= 0.0
            assert distance.min() > -0.021 * solution.depth_m
            assert solution.force_n == pytest.approx(command.force_n or solution.force_n, rel=1e-9)

    layers = [half_space(modulus, 0.5) for modulus in (1e4, 1e6, 1e12)]
    layers += [ElasticLayer(modulus_pa=modulus, poisson=0.3, thickness_m=0.003) for modulus in (1e4, 1e6, 1e12)]
    every_case([(name, gap, layer) for (name, gap), layer in product(gaps.items(), layers)], check)
    monkeypatch.setattr(module, "MAX_ITERATIONS", 2)
    with pytest.raises(ContactError, match=r"no convergence after 4 iterations on 24\^2 cells, \d+ of them in contact"):
        solve_layer(paraboloid(24, 0.012, skin()), Command(force_n=1.0))


def test_force_of_a_bed_under_a_paraboloid_is_the_closed_form_and_beds_in_series_share_the_depth():
    depth = 2e-4  # F = π R k d² (Johnson 1985, section 4.3)
    solution = solve_winkler(paraboloid(256, 0.006, skin()), Command(depth_m=depth))
    assert_allclose(solution.force_n, math.pi * RADIUS * bed_stiffness(skin()) * depth**2, rtol=1e-3)
    soft = ElasticLayer(modulus_pa=1e5, poisson=0.0, thickness_m=0.01)
    problem = paraboloid(24, 0.012, skin(), soft)
    solution = solve_winkler(problem, Command(force_n=0.5))
    assert_allclose(solution.displacement.sum(axis=0), np.maximum(solution.depth_m - problem.gap, 0.0), atol=1e-15)
    first, second = solution.displacement
    assert_allclose(first * bed_stiffness(skin()), second * bed_stiffness(soft), rtol=1e-9)
    for command, rule in ((Command(force_n=1e4), "compressed by"), (Command(depth_m=0.1), "compressed by|window is")):
        with pytest.raises(ContactError, match=rule):
            solve_winkler(problem, command)


def curved(x, y):
    """A cylinder."""
    return -((np.cos(0.7) * x + np.sin(0.7) * y) ** 2) / (2 * 0.033)


CONTACTS = [  # pitch and roll, force, height of the object
    ((0.0, 0.0), 3.0, lambda x, _y: np.zeros_like(x)),
    ((0.3, -0.4), 1.0, curved),
    ((-0.2, 0.2), 5.0, curved),
    ((0.2, 0.3), 2.0, lambda x, y: rounded_edge(np.cos(0.5) * x + np.sin(0.5) * y)),
]


def test_the_level_that_auto_takes_gives_the_electrodes_of_a_solve_at_128_x_128():
    def drops(pad, contact, other, level):
        return FINGER.electrode_rest - read_contact(pad, FINGER, *press(pad, *contact, other, level))[1:]

    def check(_name, other, error, contact):
        pad = PAD.soft if other else PAD
        coarse = drops(pad, contact, other, "auto")
        fine = drops(pad.replace(cells=128), contact, other, "layer")
        assert np.linalg.norm(coarse - fine) <= error * np.linalg.norm(fine)

    foam = ElasticLayer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03)
    rubber = ElasticLayer(modulus_pa=1e6, poisson=0.3, thickness_m=0.01)
    objects = (("rigid", (), 0.03), ("foam", (foam,), 0.02), ("rubber", (rubber,), 0.02))
    every_case([(*item, contact) for item in objects for contact in CONTACTS], check)


def test_the_pad_passes_through_the_electrodes_and_its_window_fits_it():
    positions = BIOTAC_SP.layout.positions
    inside = (1 - np.linalg.norm(positions / (PAD.skin_axes - PAD.layer_m), axis=1)) * np.linalg.norm(positions, axis=1)
    assert np.abs(inside[:20]).max() < 3e-5
    assert 0.0 < inside[20:].min() < inside[20:].max() < 4e-4  # the flat in the middle
    for config, angles in ((PAD, (0.6, -0.4)), (PAD.replace(window_m=0.03), (0.1, 0.9))):
        window = pad_window(config, pad_direction(*angles))
        on_pad = np.isfinite(window.depth)
        assert 0 < on_pad.sum() < on_pad.size  # it reaches beside the pad
        assert window.depth.min() >= 0.0
        assert_allclose(np.linalg.norm(window.points[on_pad] / PAD.skin_axes, axis=-1), 1.0, rtol=1e-12)
    height = np.where(window.x < 0.002, -50 * window.x**2, -np.inf)
    gap = gap_field(window.depth, height)
    assert gap.min() == 0.0
    assert np.isinf(gap[window.x >= 0.002]).all()
    with pytest.raises(ContactError, match="no cell of the window holds both"):
        gap_field(np.zeros((2, 2)), np.full((2, 2), -np.inf))
    with pytest.raises(ContactError, match="points to the nail"):
        contact_frame(PAD, np.array([1.0, 0.0, 0.0]))
