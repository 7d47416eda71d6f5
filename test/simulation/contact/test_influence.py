# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import dblquad
from scipy.signal import convolve2d

from foretouch.simulation.contact import Layer, bed_stiffness
from foretouch.simulation.contact.layer import (
    convolve,
    influence_spectrum,
    layer_influence,
    layer_transfer,
    love_influence,
)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.5])
def test_short_waves_see_a_half_space(poisson):
    assert_allclose(layer_transfer([20.0, 1e3, 1e6], poisson), 1.0, rtol=1e-12)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
def test_long_waves_see_the_winkler_bed(poisson):
    t = 1e-4
    layer = Layer(modulus_pa=2e6, poisson=poisson, thickness_m=0.003)
    compliance = 2.0 * layer.thickness_m / (layer.plane_modulus_pa * t) * layer_transfer(t, poisson)
    assert_allclose(compliance, 1.0 / bed_stiffness(layer), rtol=1e-6)


def test_coefficients_of_the_half_space_match_quadrature():
    step, modulus = 2e-4, 1e6
    for i, j in ((1, 0), (2, 3)):
        x, y = i * step, j * step
        direct, _ = dblquad(
            lambda v, u, x=x, y=y: 1.0 / math.hypot(x - u, y - v), -step / 2, step / 2, -step / 2, step / 2
        )
        value = love_influence(np.array(x), np.array(y), step, modulus)
        assert_allclose(value, direct / (math.pi * modulus), rtol=1e-6)


def test_coefficient_of_a_cell_on_itself_is_loves():
    step, modulus = 1e-3, 1e6
    value = love_influence(np.array(0.0), np.array(0.0), step, modulus)
    assert_allclose(value, 4 * math.log(1 + math.sqrt(2)) * step / (math.pi * modulus), rtol=1e-12)


@pytest.mark.parametrize("thickness", [0.0005, 0.001, 0.003])
def test_layer_under_even_pressure_is_the_winkler_bed(thickness):
    layer = Layer(modulus_pa=1e6, poisson=0.3, thickness_m=thickness)
    quarter = layer_influence(layer, 80, 5e-4)
    total = 4 * quarter[1:, 1:].sum() + 2 * quarter[0, 1:].sum() + 2 * quarter[1:, 0].sum() + quarter[0, 0]
    assert_allclose(total, 1.0 / bed_stiffness(layer), rtol=0.01)


def test_thick_layer_is_a_half_space():
    thick = layer_influence(Layer(modulus_pa=1e6, poisson=0.3, thickness_m=10.0), 16, 5e-4)
    assert_allclose(thick, layer_influence(Layer(modulus_pa=1e6, poisson=0.3), 16, 5e-4), rtol=0.01)


def test_convolution_is_the_direct_sum(rng):
    layer, n = Layer(modulus_pa=1e6, poisson=0.316, thickness_m=0.0015), 9
    pressure = rng.random((n, n))
    quarter = layer_influence(layer, n, 5e-4)
    full = np.block([[quarter[:0:-1, :0:-1], quarter[:0:-1]], [quarter[:, :0:-1], quarter]])
    expected = convolve2d(pressure, full, mode="full")[n - 1 : 2 * n - 1, n - 1 : 2 * n - 1]
    assert_allclose(convolve(pressure, influence_spectrum(layer, n, 5e-4)), expected, rtol=1e-10)
