# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import sys
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

sys.path.insert(0, str(Path(__file__).parent))
from contact_builders import paraboloid, skin

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, Layer, solve_grip

FOAM = Layer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03)
SHARP = paraboloid(24, 0.012, skin(), radius=0.004)
BLUNT = paraboloid(24, 0.012, skin(), radius=0.02)


def test_fingers_follow_their_own_commands():
    grip = solve_grip([SHARP, BLUNT], [Command(force_n=1.0), Command(depth_m=2e-4)], balanced=False)
    assert grip.first.force_n == pytest.approx(1.0)
    assert grip.second.depth_m == 2e-4


@pytest.mark.parametrize("level", ["hertz", "winkler", "layer"])
@pytest.mark.parametrize("closing", [1e-6, 2e-4, 5e-4])
def test_closing_balances_the_fingers(level, closing):
    grip = solve_grip([SHARP, BLUNT], [Command(depth_m=closing / 2)] * 2, balanced=True, level=level)
    assert grip.imbalance <= 1e-3
    assert_allclose(grip.first.depth_m + grip.second.depth_m, closing, rtol=2e-5)
    assert grip.first.depth_m >= grip.second.depth_m  # the sharp side sinks in deeper, unless both are one cell


def test_soft_object_balances_too():
    soft = [paraboloid(24, 0.02, skin(), FOAM, radius=r) for r in (0.008, 0.03)]
    grip = solve_grip(soft, [Command(depth_m=2e-3), Command(depth_m=1e-3)], balanced=True)
    assert grip.imbalance <= 1e-3
    assert_allclose(grip.first.depth_m + grip.second.depth_m, 3e-3, rtol=2e-5)


@pytest.mark.parametrize("commands", [[Command(force_n=3.0)] * 2, [Command(depth_m=3e-4)] * 2])
def test_weight_along_the_line_loads_the_second_finger(commands):
    grip = solve_grip([BLUNT, BLUNT], commands, balanced=True, axial_load_n=0.4)
    assert_allclose(grip.second.force_n - grip.first.force_n, 0.4, rtol=1e-9)


def test_open_hand_touches_nothing():
    grip = solve_grip([SHARP, BLUNT], [Command(depth_m=-1e-3), Command(depth_m=1e-4)], balanced=True)
    assert grip.first.force_n == grip.second.force_n == grip.imbalance == 0.0


@pytest.mark.parametrize(
    ("commands", "load", "message"),
    [
        ([Command(force_n=1.0), Command(force_n=2.0)], 0.0, "1 and 2 N cannot balance"),
        ([Command(force_n=1.0), Command(depth_m=1e-4)], 0.0, "two forces or two depths"),
        ([Command(force_n=0.5)] * 2, 2.0, "2 N opens a grip of 0.5 N"),
    ],
)
def test_commands_that_contradict_each_other_are_refused(commands, load, message):
    with pytest.raises(ContactError, match=message):
        solve_grip([SHARP, BLUNT], commands, balanced=True, axial_load_n=load)


def test_load_on_a_held_object_is_refused():
    with pytest.raises(ContactError, match="holds the object in place"):
        solve_grip([SHARP, BLUNT], [Command(force_n=1.0)] * 2, balanced=False, axial_load_n=1.0)


def test_one_finger_is_no_grip():
    with pytest.raises(ContactError, match="1 contacts and 1 commands"):
        solve_grip([SHARP], [Command(force_n=1.0)], balanced=False)
