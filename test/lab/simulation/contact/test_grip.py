# SPDX-License-Identifier: Apache-2.0
from itertools import product

import numpy as np
import pytest
from contact_builders import paraboloid, skin
from every_case import every_case
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch_lab.simulation.contact.grip import LEVELS, solve_grip, weigh
from foretouch_lab.simulation.contact.problem import Command, ElasticLayer

FOAM = ElasticLayer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03)
SHARP = paraboloid(24, 0.012, skin(), radius=0.004)
BLUNT = paraboloid(24, 0.012, skin(), radius=0.02)
ON_THE_TABLE = np.array([0.0, 0.0, -4.0]), np.array([-0.04, 0, 0]), np.array([0.04, 0, 0]), np.array([0.02, 0, 0])


def test_closing_balances_the_fingers():
    def check(problems, level, closing):
        first, second = solve_grip(problems, Command(depth_m=closing / 2), 0.0, level)
        assert_allclose(first.force_n, second.force_n, rtol=1e-3)
        assert_allclose(first.depth_m + second.depth_m, closing, rtol=2e-5)
        assert first.depth_m >= second.depth_m  # the sharp side sinks in deeper, unless both are one cell

    soft = [paraboloid(24, 0.02, skin(), FOAM, radius=r) for r in (0.008, 0.03)]
    every_case([*product(([SHARP, BLUNT],), LEVELS, (1e-6, 2e-4, 5e-4)), (soft, "auto", 3e-3)], check)


def test_weight_along_the_line_loads_the_second_finger_and_an_open_hand_touches_nothing():
    for command in (Command(force_n=3.0), Command(depth_m=3e-4)):
        first, second = solve_grip([BLUNT, BLUNT], command, 0.4)
        assert_allclose(second.force_n - first.force_n, 0.4, rtol=1e-9)
    assert [contact.force_n for contact in solve_grip([SHARP, BLUNT], Command(depth_m=0.0), 0.0)] == [0.0, 0.0]
    with pytest.raises(ContactError, match=r"2 N opens a grip of 0.5 N"):
        solve_grip([SHARP, BLUNT], Command(force_n=0.5), 2.0)


def test_a_held_weight_balances_and_a_level_grip_shares_it_by_the_lever(rng):
    for _ in range(20):
        weight, g1, g2, centre = rng.normal(size=(4, 3))
        (axial_n, across_n), axis = weigh(weight, g1, g2, centre), (g2 - g1) / np.linalg.norm(g2 - g1)
        scale = np.linalg.norm(weight) * (1.0 + np.abs([g1, g2, centre]).max() / np.linalg.norm(g2 - g1))
        forces = np.outer([7.0, -7.0 - axial_n], axis) - across_n
        assert_allclose(forces.sum(axis=0) + weight, 0.0, atol=1e-13 * (scale + 7.0))
        moment = np.cross([g1 - centre, g2 - centre], forces).sum(axis=0)
        assert_allclose(np.cross(moment, axis), 0.0, atol=1e-12 * scale)  # what is left turns about the line
    axial_n, across_n = weigh(*ON_THE_TABLE)
    assert_allclose(across_n, [[0, 0, -1.0], [0, 0, -3.0]], atol=1e-12)
    assert axial_n == 0.0
