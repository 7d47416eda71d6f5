# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from foretouch.errors import ConfigError, TactileError
from foretouch.simulation.contact import (
    Command,
    ContactProblem,
    PadConfig,
    gap_field,
    pad_direction,
    pad_window,
    solve_contact,
)
from foretouch.simulation.fingertip import (
    MIDDLE_FINGER,
    THUMB,
    FingerConfig,
    FingertipConfig,
    draw_finger,
    quantise,
    read_contact,
)
from foretouch.tactile import P2_RANGES, touch_faults
from foretouch.types import Touch

PAD = PadConfig()
CONFIG = FingertipConfig()


def read(finger, force, pitch=0.0, roll=0.0):
    window = pad_window(PAD, pad_direction(pitch, roll))
    problem = ContactProblem(gap_field(window.depth, np.zeros_like(window.x)), PAD.step_m, (PAD.layer,))
    return read_contact(CONFIG, PAD, finger, window, solve_contact(problem, Command(force_n=force)))


@pytest.fixture
def thumb():
    return draw_finger(THUMB, np.random.default_rng(0))


def test_no_force_reads_rest_to_the_bit(thumb):
    reading = read(thumb, 0.0)
    assert reading.pdc == thumb.pdc_rest
    assert_array_equal(reading.electrodes, thumb.electrode_rest)


def test_touch_raises_pdc_and_drops_the_electrodes_below(thumb):
    reading = read(thumb, 2.0)
    assert reading.pdc > thumb.pdc_rest + 100
    drop = thumb.electrode_rest - reading.electrodes
    assert drop[[4, 14]].min() > 150  # electrodes 5 and 15, under the contact
    assert drop[[0, 9, 10, 19]].max() < 0  # far ones see the skin bulge


def test_harder_touch_drops_more_and_goes_on_where_pdc_is_level(thumb):
    two, four = read(thumb, 2.0), read(thumb, 4.0)
    assert four.pdc - two.pdc < 0.1 * (two.pdc - thumb.pdc_rest)
    assert four.electrodes.min() < two.electrodes.min() - 100


def test_same_pdc_with_another_pattern(thumb):
    left, right = read(thumb, 3.0, 0.2, 0.3), read(thumb, 3.0, 0.2, -0.3)
    assert left.pdc == pytest.approx(right.pdc, rel=1e-6)
    assert np.abs(left.electrodes - right.electrodes).max() > 100


def test_reading_passes_as_one_of_a_working_sensor(thumb):
    middle = draw_finger(MIDDLE_FINGER, np.random.default_rng(1))
    counts = [quantise(CONFIG, r.pdc, r.electrodes) for r in (read(thumb, 3.0), read(middle, 3.0))]
    (pdc_th, e_th), (pdc_mf, e_mf) = counts
    touch = Touch(float(pdc_th), float(pdc_mf), e_th.astype(float), e_mf.astype(float))
    assert touch_faults(touch) == ()
    assert not P2_RANGES.outside(touch.vector()).any()


def test_counts_are_whole_and_clipped():
    pdc, electrodes = quantise(FingertipConfig(pdc_highest=3000), [1676.4, 5000.0], [-3.0, 1.6, 5000.0])
    assert_array_equal(pdc, [1676, 3000])
    assert_array_equal(electrodes, [0, 2, 4095])
    assert pdc.dtype == electrodes.dtype == np.int64


def test_no_count_for_what_is_not_finite():
    with pytest.raises(TactileError, match="electrodes: 1 values are not finite"):
        quantise(CONFIG, 1.0, [1.0, np.nan])


def test_empty_range_of_pdc_is_refused():
    with pytest.raises(ConfigError, match="pdc_lowest: 2000 is not below pdc_highest 2000"):
        FingertipConfig(pdc_lowest=2000, pdc_highest=2000)


def test_fingers_differ_by_seed_and_not_by_spread():
    equal = draw_finger(FingerConfig(electrode_rest_spread=0.0, electrode_gain_spread=0.0), np.random.default_rng(0))
    assert np.ptp(equal.electrode_rest) == np.ptp(equal.electrode_gain) == 0.0
    one, two = (draw_finger(THUMB, np.random.default_rng(seed)) for seed in (0, 1))
    assert np.abs(one.electrode_rest - two.electrode_rest).max() > 50
