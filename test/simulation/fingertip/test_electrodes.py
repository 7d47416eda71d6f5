# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import ContactError
from foretouch.simulation.contact import PadConfig, pad_direction, pad_window
from foretouch.simulation.fingertip import (
    ElectrodeConfig,
    counts_at,
    electrode_counts,
    electrode_weights,
    skin_approach,
)
from foretouch.tactile import electrode_normals, electrode_positions, to_kohm

PAD = PadConfig()
CONFIG = ElectrodeConfig()


def weights_at(pitch, roll, pad=PAD, config=CONFIG):
    window = pad_window(pad, pad_direction(pitch, roll))
    return electrode_weights(config, pad, window.frame, window.points)


def test_nearest_electrodes_weigh_most():
    totals = weights_at(0.0, 0.0).sum(axis=1)
    below = np.linalg.norm(electrode_positions()[:, :2], axis=1)  # distance from the middle of the pad, in plan
    assert np.argmax(totals) in np.argsort(below)[:4]
    assert totals[[0, 9, 10, 19]].max() < 0.05  # tip and end, 10 mm away


def test_even_displacement_counts_fully_but_for_the_bend_of_the_skin():
    totals = weights_at(0.0, 0.0, config=ElectrodeConfig(kernel_m=0.0008)).sum(axis=1)
    facing = electrode_normals() @ pad_direction(0.0, 0.0)
    # once for the electrode that looks aside, once for cells that are seen foreshortened from the tangent plane
    assert_allclose(totals[[4, 14]], facing[[4, 14]] ** 2, atol=0.02)


def test_left_and_right_mirror_each_other():
    left, right = weights_at(0.2, -0.4).sum(axis=1), weights_at(0.2, 0.4).sum(axis=1)
    assert_allclose(left[:10], right[10:20], rtol=1e-9)
    assert_allclose(left[20], right[20], rtol=1e-9)
    assert_allclose(left[21], right[22], rtol=1e-9)


def test_cells_beside_the_pad_count_nothing():
    wide = PAD.replace(window_m=0.03, cells=30)
    window = pad_window(wide, pad_direction(0.0, 0.9))
    weights = electrode_weights(CONFIG, wide, window.frame, window.points)
    assert np.isfinite(weights).all()
    assert not weights[:, ~np.isfinite(window.depth).ravel()].any()


def test_weights_do_not_depend_on_the_grid():
    coarse, fine = weights_at(0.1, 0.2), weights_at(0.1, 0.2, PAD.replace(cells=96))
    assert_allclose(coarse.sum(axis=1), fine.sum(axis=1), atol=1e-3)


def test_displaced_liquid_lifts_the_skin_elsewhere():
    approach = skin_approach(CONFIG, np.zeros((24, 4)), np.zeros((2, 2)), 1e-9)
    assert_allclose(approach, -1e-9 / CONFIG.bulge_area_m2)


def test_closer_skin_lowers_the_count_and_a_bulge_raises_it():
    counts = electrode_counts(CONFIG, np.array([-1e-5, 0.0, 1e-5, 1e-4]), np.full(4, 3500.0))
    assert (np.diff(counts) < 0).all()
    assert counts[1] == pytest.approx(3500.0)


def test_one_thinning_length_raises_the_impedance_by_e():
    counts = electrode_counts(CONFIG, np.array([CONFIG.thinning_m]), np.array([3500.0]))
    assert_allclose(to_kohm(counts) / to_kohm(3500.0), np.e, rtol=1e-12)


def test_counts_are_the_inverse_of_the_manuals_formula():
    counts = np.array([1.0, 172.0, 2000.0, 4000.0])
    assert_allclose(counts_at(to_kohm(counts)), counts, rtol=1e-12)


def test_crushed_skin_stays_finite():
    counts = electrode_counts(CONFIG, np.array([-1.0, 1.0]), np.full(2, 3500.0))
    assert_allclose(counts, [4095.0, 0.0], atol=1e-6)


def test_displacement_on_another_grid_is_refused():
    with pytest.raises(ContactError, match="displacement: 9 cells, but weights for 4"):
        skin_approach(CONFIG, np.zeros((24, 4)), np.zeros((3, 3)), 0.0)
