# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.types import Float64
from foretouch_lab.simulation.contact.grip import solve_contact
from foretouch_lab.simulation.contact.problem import (
    STEEPEST,
    Command,
    ContactProblem,
    ElasticLayer,
    skin_slopes,
    tractions,
)

STEP_M, RADIUS_M, FRICTION, FORCE_N = 2.5e-4, 0.03, 0.6, 2.0
OFFSET = (np.arange(48) - 23.5) * STEP_M
X, Y = np.meshgrid(OFFSET, OFFSET)
BALL = (X**2 + Y**2) / (2.0 * RADIUS_M)


def shear(
    tangential_n: tuple[float, float], level: str = "winkler", friction: float = FRICTION, thickness_m: float = 0.003
) -> tuple[Float64, Float64]:
    """Pressure and tractions of a ball that presses on a flat pad, without the slopes of the skin."""
    layer = ElasticLayer(modulus_pa=5e5, poisson=0.3, thickness_m=thickness_m)
    problem = ContactProblem(BALL - BALL.min(), STEP_M, (layer,))

    def press(force_n: float) -> Float64:
        return solve_contact(problem, Command(force_n=force_n), level).pressure

    contact, none = solve_contact(problem, Command(force_n=FORCE_N), level), np.zeros((48, 48, 2))
    found = tractions(contact, problem.cell_m2, none, np.array(tangential_n), friction, press)
    return contact.pressure, found


@pytest.mark.parametrize("level", ["winkler", "layer"])
def test_friction_carries_the_tangential_force_within_coulombs_limit_in_each_cell(level: str) -> None:
    pressure, found = shear((0.4, -0.3), level)
    assert_allclose(found[..., :2].sum(axis=(0, 1)) * STEP_M**2, (0.4, -0.3), rtol=2e-3)
    assert_allclose(found[..., 2], -pressure)
    across = np.linalg.norm(found[..., :2], axis=-1)
    assert (across <= FRICTION * pressure * (1.0 + 1e-9) + 1e-6).all()
    slipping, pressed = across > 0.999 * FRICTION * pressure, pressure > 0.0
    assert slipping[pressed].any()  # an annulus slips, its middle sticks
    assert not slipping[pressed].all()


def test_the_stick_radius_is_that_of_mindlin() -> None:
    """c / a = (1 - T / (µ N))^(1/3) for a ball on a half-space (Johnson 1985, eq. 7.43)."""
    pressure, found = shear((0.5, 0.0), "layer", thickness_m=math.inf)
    slipping = found[..., 0] > 0.999 * FRICTION * pressure
    stick_m2 = (~slipping & (pressure > 0.0)).sum() / (pressure > 0.0).sum()
    assert math.sqrt(stick_m2) == pytest.approx((1.0 - 0.5 / (FRICTION * FORCE_N)) ** (1.0 / 3.0), abs=0.06)


def test_more_than_coulombs_limit_slips_and_without_friction_there_is_none() -> None:
    pressure, found = shear((3.0, 4.0))
    assert_allclose(found[..., :2], FRICTION * pressure[..., None] * [0.6, 0.8])
    assert not shear((0.4, 0.0), friction=0.0)[1][..., :2].any()
    assert not shear((0.0, 0.0))[1][..., :2].any()


def test_slopes_of_the_skin_are_those_of_its_surface_and_its_edges_count_for_nothing() -> None:
    depth = 0.1 * X + 2.0 * Y**2
    depth[:, :5] = np.inf
    found = skin_slopes(depth, STEP_M)
    assert_allclose(found[:, 5:, 0], -0.1, atol=1e-9)
    assert_allclose(found[1:-1, 5:, 1], -4.0 * Y[1:-1, 5:], atol=1e-9)
    assert not found[:, :5].any(where=np.abs(found[:, :5]) > 4.0 * np.abs(Y).max())
    assert skin_slopes(-3.0 * X, STEP_M).max() == STEEPEST
