# SPDX-License-Identifier: Apache-2.0
"""Descent of the elastic layer, compiled and by NumPy."""

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

sys.path.insert(0, str(Path(__file__).parents[1] / "simulation" / "contact"))
from contact_builders import skin

from foretouch import kernels
from foretouch.simulation.contact import Command, ContactConfig, ContactProblem, Layer
from foretouch.simulation.contact import layer as layers


@pytest.mark.parametrize("n", [8, 9, 12, 15, 20, 24, 32, 40, 48])
@pytest.mark.parametrize("command", [Command(force_n=1.0), Command(depth_m=3e-4)], ids=["force", "depth"])
def test_they_take_the_same_steps(n: int, command: Command, rng) -> None:
    """Radices 2, 3, 4 and 5, odd and even sides, cells that join and cells that let go."""
    x = np.linspace(-0.006, 0.006, n)
    gap = (x[:, None] ** 2 + x**2) / 0.02 + 1e-5 * rng.normal(size=(n, n))
    soft = Layer(modulus_pa=3e5, poisson=0.3, thickness_m=0.01)
    problem = ContactProblem(gap - gap.min(), float(x[1] - x[0]), (skin(), soft))
    start = layers.expected_pressure(problem, command)
    compiled = layers._descend(problem, command, ContactConfig(), problem.gap, start)
    with kernels.disabled():
        plain = layers._descend(problem, command, ContactConfig(), problem.gap, start)
    assert compiled.iterations == plain.iterations > 2
    assert_allclose(compiled.pressure, plain.pressure, rtol=0.0, atol=1e-13 * plain.pressure.max())
    assert_allclose([compiled.depth, compiled.residual], [plain.depth, plain.residual], rtol=1e-10, atol=1e-14)


def test_a_side_with_another_factor_is_left_to_numpy() -> None:
    problem = ContactProblem(np.zeros((7, 7)), 1e-3, (skin(),))
    command = Command(force_n=1.0)
    args = problem, command, ContactConfig(), problem.gap, np.ones((7, 7))
    compiled = layers._descend(*args)
    with kernels.disabled():
        assert np.array_equal(compiled.pressure, layers._descend(*args).pressure)
    assert (
        layers._compiled_descent(
            problem.gap, layers._spectra(problem.layers, 7, 1e-3)[1], np.ones((7, 7)), 1e-4, None, args[2]
        )
        is None
    )
