# SPDX-License-Identifier: Apache-2.0
"""Descent of the elastic layer, compiled and by NumPy."""

from itertools import product

import numpy as np
from contact_builders import skin
from every_case import every_case
from kernels.references import layer as reference
from numpy.testing import assert_allclose

from foretouch_lab.simulation.contact import layer as layers
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer

LIMITS = layers.TOLERANCE, layers.MAX_ITERATIONS


def test_they_take_the_same_steps(rng) -> None:
    """Every radix, odd and even sides, cells that join and cells that let go."""
    soft = ElasticLayer(modulus_pa=3e5, poisson=0.3, thickness_m=0.01)

    def check(n: int, command: Command) -> None:
        x = np.linspace(-0.006, 0.006, n)
        gap = (x[:, None] ** 2 + x**2) / 0.02 + 1e-5 * rng.normal(size=(n, n))
        problem = ContactProblem(gap - gap.min(), float(x[1] - x[0]), (skin(), soft))
        start = layers._expected_pressure(problem, command)
        pressure, depth, iterations, residual = layers._descend(problem, command, problem.gap, start)
        plain = reference.descend(problem, command, problem.gap, start, *LIMITS)
        assert iterations == plain[2] > 2
        assert_allclose(pressure, plain[0], rtol=0.0, atol=1e-12 * plain[0].max())
        assert_allclose(depth, plain[1], rtol=1e-10)
        assert_allclose(residual, plain[3], rtol=0.0, atol=1e-12 * n * n)  # a sum over all cells

    sides = (7, 8, 9, 11, 12, 15, 20, 21, 24, 32, 40, 46, 48)
    every_case(product(sides, (Command(force_n=1.0), Command(depth_m=3e-4))), check)
