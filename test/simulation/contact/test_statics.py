# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch.simulation.contact import weigh


def test_forces_and_moments_balance(rng):
    for _ in range(20):
        weight, g1, g2, centre = rng.normal(size=(4, 3))
        held = weigh(weight, g1, g2, centre)
        axis = (g2 - g1) / np.linalg.norm(g2 - g1)
        first = held.tangential_n[0] + 7.0 * axis
        second = held.tangential_n[1] - (7.0 + held.axial_n) * axis
        assert_allclose(first + second + weight, 0.0, atol=1e-12)
        moment = sum(np.cross(p - centre, f) for p, f in ((g1, first), (g2, second)))
        assert_allclose(moment, held.torsion_nm * axis, atol=1e-10)
        assert_allclose(held.tangential_n @ axis, 0.0, atol=1e-12)


def test_level_grip_shares_the_weight_by_the_lever():
    held = weigh(np.array([0.0, 0.0, -4.0]), np.array([-0.04, 0, 0]), np.array([0.04, 0, 0]), np.array([0.02, 0, 0]))
    assert_allclose(held.tangential_n, [[0, 0, 1.0], [0, 0, 3.0]], atol=1e-12)
    assert held.axial_n == 0.0


def test_finger_slips_beyond_its_friction():
    held = weigh(np.array([0.0, 0.0, -4.0]), np.array([-0.04, 0, 0]), np.array([0.04, 0, 0]), np.array([0.02, 0, 0]))
    assert held.slips((3.0, 3.0), 0.5) == (False, True)


def test_contacts_that_coincide_are_refused():
    with pytest.raises(ContactError, match="contacts coincide"):
        weigh(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3))
