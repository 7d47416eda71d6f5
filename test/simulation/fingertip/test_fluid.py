# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.simulation.contact import (
    Command,
    ContactProblem,
    PadConfig,
    contact_frame,
    gap_field,
    pad_direction,
    pad_window,
    solve_winkler,
)
from foretouch.simulation.fingertip import FluidConfig, displaced_volume, pdc_counts

PAD = PadConfig()
CONFIG = FluidConfig()


def rise(force):
    window = pad_window(PAD, pad_direction(0.0, 0.0))
    problem = ContactProblem(gap_field(window.depth, np.zeros_like(window.x)), PAD.step_m, (PAD.layer,))
    skin = solve_winkler(problem, Command(force_n=force)).displacement[0]
    return pdc_counts(CONFIG, window.frame, displaced_volume(CONFIG, skin, PAD.step_m**2), 0.0)


def test_pdc_is_linear_at_low_force():
    assert_allclose(rise(0.2) / rise(0.1), 2.0, rtol=0.02)
    assert_allclose(rise(0.4) / rise(0.1), 4.0, rtol=0.06)


def test_pdc_levels_off_near_two_newtons():
    first, second, third = rise(1.0), rise(2.0) - rise(1.0), rise(4.0) - rise(2.0)
    assert rise(2.0) > 0.85 * CONFIG.span_counts
    assert third / 2.0 < 0.1 * first
    assert second < 0.5 * first


def test_pdc_rises_with_pressure_and_with_gain():
    frame = contact_frame(PAD, pad_direction(0.0, 0.0))
    assert pdc_counts(CONFIG, frame, 1e-9, 1676.0) > 1676.0
    assert pdc_counts(CONFIG, frame, 1e-9, 0.0, 2.0) == pytest.approx(2 * pdc_counts(CONFIG, frame, 1e-9, 0.0))


def test_rim_answers_less_than_the_middle():
    middle, rim = (contact_frame(PAD, pad_direction(0.0, roll)) for roll in (0.0, 1.0))
    expected = np.cos(1.0) ** CONFIG.rim_power * pdc_counts(CONFIG, middle, 1e-9, 0.0)
    assert pdc_counts(CONFIG, rim, 1e-9, 0.0) == pytest.approx(expected)


def test_skin_on_the_core_displaces_no_more_liquid():
    deep = np.full((2, 2), 10 * CONFIG.bottoming_m)
    assert displaced_volume(CONFIG, deep, 1e-6) == pytest.approx(4e-6 * CONFIG.bottoming_m)
    assert displaced_volume(CONFIG, -deep, 1e-6) == 0.0
