# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest

from foretouch.errors import ContactError
from foretouch.simulation.contact import Command, ContactProblem, Layer

SOFT = Layer(modulus_pa=1e5, poisson=0.3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"modulus_pa": 0.0}, "modulus_pa: 0.0 is not positive"),
        ({"modulus_pa": math.nan}, "modulus_pa: nan"),
        ({"poisson": 0.51}, "poisson: 0.51 is not between 0 and 0.5"),
        ({"thickness_m": -1.0}, "thickness_m: -1.0 is not positive"),
        ({"thickness_m": math.nan}, "thickness_m: nan"),
    ],
)
def test_layer_without_meaning_is_refused(changes, message):
    with pytest.raises(ContactError, match=message):
        Layer(**{"modulus_pa": 1e6, "poisson": 0.3, **changes})


@pytest.mark.parametrize(
    ("gap", "message"),
    [
        (np.zeros((3, 4)), r"gap: shape \(3, 4\) is not \(N, N\)"),
        (np.full((3, 3), np.inf), "nowhere in the window do both surfaces exist"),
        (np.array([[0.0, np.nan], [0.0, 0.0]]), "gap: holds NaN"),
        (np.ones((3, 3)), "its least value is 1 m, not 0"),
    ],
)
def test_gap_that_is_none_is_refused(gap, message):
    with pytest.raises(ContactError, match=message):
        ContactProblem(gap, 1e-3, (SOFT,))


def test_two_rigid_bodies_are_refused():
    with pytest.raises(ContactError, match="layers: none is compliant"):
        ContactProblem(np.zeros((3, 3)), 1e-3, ())


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ({}, "give force_n or depth_m, one of them"),
        ({"force_n": 1.0, "depth_m": 1.0}, "give force_n or depth_m, one of them"),
        ({"force_n": -1.0}, "force_n: -1.0 is negative"),
        ({"depth_m": math.inf}, "depth_m: inf is not finite"),
    ],
)
def test_command_that_contradicts_itself_is_refused(command, message):
    with pytest.raises(ContactError, match=message):
        Command(**command)


def test_contact_modulus_of_two_equal_bodies_is_half_of_one():
    assert ContactProblem(np.zeros((3, 3)), 1e-3, (SOFT, SOFT)).contact_modulus_pa == pytest.approx(
        SOFT.plane_modulus_pa / 2
    )
