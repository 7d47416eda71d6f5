# SPDX-License-Identifier: Apache-2.0
"""Forces and depths from the smallest to the largest float: a finite result or a named refusal, without a warning."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from contact_builders import paraboloid, skin

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, Layer, solve_hertz, solve_layer, solve_winkler

VALUES = [5e-324, 1e-310, 1e-200, 1e-100, 1e-30, 1e-12, 1e-3, 1.0, 1e3, 1e30, 1e100, 1e200, 1e300, 1.7e308]


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("kind", ["force_n", "depth_m"])
@pytest.mark.parametrize("solve", [solve_layer, solve_winkler, solve_hertz])
def test_any_float_is_solved_or_refused_by_name(solve, kind: str, value: float) -> None:
    problem = paraboloid(24, 0.006, skin(0.002))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            found = solve(problem, Command(**{kind: value}))
        except ContactError as err:
            assert str(err).partition(":")[0] in ("layers[0]", "depth", kind)  # noqa: PT017
            return
    assert np.isfinite([found.force_n, found.depth_m, found.area_m2]).all()
    assert np.isfinite(found.pressure).all()
    assert np.isfinite(found.displacement).all()
    np.testing.assert_allclose(getattr(found, kind), value, rtol=1e-9)


def test_small_forces_are_proportional_to_the_pressure() -> None:
    problem = paraboloid(24, 0.006, skin(0.002))
    small, smaller = (solve_layer(problem, Command(force_n=force)) for force in (1e-9, 1e-29))
    np.testing.assert_allclose(smaller.pressure * 1e20, small.pressure, rtol=1e-6)


@pytest.mark.parametrize("modulus", [5e-324, 1e-200, 1e200, 1.7e308])
def test_a_modulus_of_no_material_is_refused(modulus: float) -> None:
    with pytest.raises(ContactError, match=r"modulus_pa: .* is not between"):
        Layer(modulus_pa=modulus, poisson=0.3)
