# SPDX-License-Identifier: Apache-2.0

from dataclasses import replace

import numpy as np
import pytest
from contact_builders import press, rounded_edge
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import TactileError
from foretouch.tactile import BIOTAC_SP, P2_RANGES, biotac_touch, to_kohm, touch_faults
from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.contact.pad import PadConfig, pad_direction, pad_window
from foretouch_lab.simulation.contact.problem import ContactSolution
from foretouch_lab.simulation.fingertip import (
    NOISE_ELECTRODE,
    NOISE_PDC,
    SimulatedFingerConfig,
    ThumbConfig,
    draw_finger,
    quantise,
    read_contact,
)

PAD = PadConfig()
THUMB = draw_finger(ThumbConfig(), np.random.default_rng(0))


def read(force, pitch=0.0, roll=0.0, finger=THUMB):
    return read_contact(PAD, finger, *press(PAD, (pitch, roll), force))


def test_touch_raises_pdc_and_drops_the_electrodes_below_and_no_force_reads_rest_to_the_bit():
    assert_array_equal(read(0.0), np.append(THUMB.pdc_rest, THUMB.electrode_rest))
    two, four = read(2.0), read(4.0)
    assert two[0] > THUMB.pdc_rest + 100
    drop = THUMB.electrode_rest - two[1:]
    assert drop[[4, 14]].min() > 150  # electrodes 5 and 15, under the contact
    assert drop[[0, 9, 10, 19]].max() < 0  # far ones see the skin bulge
    assert four[1:].min() < two[1:].min() - 100
    left, right = read(3.0, 0.2, 0.3), read(3.0, 0.2, -0.3)
    assert left[0] == pytest.approx(right[0], rel=1e-6)  # the same pressure with another pattern
    assert np.abs(left[1:] - right[1:]).max() > 100


def test_counts_are_whole_clipped_and_those_of_a_working_sensor():
    middle = draw_finger(SimulatedFingerConfig(), np.random.default_rng(1))
    thumb, other = quantise(np.array([read(3.0), read(3.0, finger=middle)])).astype(float)
    touch = biotac_touch(np.hstack([thumb[0], other[0], thumb[1:], other[1:]]))
    assert touch_faults(touch) == ()
    assert not P2_RANGES.ranges.outside(touch.values).any()
    assert_array_equal(quantise(np.array([1676.4, -3.0, 1.6, 5000.0])), [1676, 0, 2, 4095])
    with pytest.raises(TactileError, match="counts: 1 values are not finite"):
        quantise(np.array([1.0, np.nan]))


def pressed_anywhere(rng):
    """Anywhere on the pad, on a plane, a cylinder or a rounded edge, with 1 to 5 N."""
    pitch, roll = rng.normal(0.0, 0.3), float(np.clip(rng.normal(0.0, 0.35), -1.2, 1.2))
    force, angle, radius = rng.uniform(1.0, 5.0), rng.uniform(0.0, np.pi), rng.uniform(0.02, 0.05)
    beside, kind = rng.normal(0.0, 0.002), rng.integers(3)

    def surface(x, y):
        across = np.cos(angle) * x + np.sin(angle) * y
        return (0.0 * x, -(across**2) / (2.0 * radius), rounded_edge(across - np.cos(angle) * beside))[kind]

    return press(PAD, (pitch, roll), force, surface)


def test_counts_spread_as_in_real_grasps():
    """The bounds are a factor of 1.5 about those of 400 real grasps."""
    deviation = np.array([NOISE_PDC, *[NOISE_ELECTRODE] * 24])
    for kind, median, percentile_99 in ((SimulatedFingerConfig(), 72.0, 691.0), (ThumbConfig(), 117.0, 986.0)):
        contacts, rng = np.random.default_rng(7), np.random.default_rng([7, 1])
        finger = draw_finger(kind, rng)
        readings = np.array([read_contact(PAD, finger, *pressed_anywhere(contacts)) for _ in range(200)])
        counts = quantise(readings + deviation * rng.standard_normal(readings.shape)).astype(np.float64)
        electrodes = counts[:, 1:]
        drop = np.percentile(electrodes, 95, axis=0) - electrodes
        variances = np.linalg.eigvalsh(np.cov(electrodes.T))[::-1]
        assert median / 1.5 < np.median(drop) < median * 1.5
        assert percentile_99 / 1.5 < np.percentile(drop, 99) < percentile_99 * 1.5
        assert 0.65 < variances[:4].sum() / variances.sum() < 0.85
        assert abs(np.corrcoef(counts[:, 0], electrodes.mean(axis=1))[0, 1]) < 0.4


def rise(force):
    return read(force)[0] - THUMB.pdc_rest


def test_pdc_is_linear_at_low_force_and_levels_off_near_two_newtons():
    assert_allclose(rise(0.2) / rise(0.1), 2.0, rtol=0.02)
    assert_allclose(rise(0.4) / rise(0.1), 4.0, rtol=0.06)
    assert rise(2.0) > 0.85 * fingertip.PDC_SPAN
    assert rise(2.0) - rise(1.0) < 0.5 * rise(1.0)
    assert (rise(4.0) - rise(2.0)) / 2.0 < 0.1 * rise(1.0)


def weights_at(pitch, roll, pad=PAD):
    return fingertip.electrode_weights(pad, pad_window(pad, pad_direction(pitch, roll)))


def test_weights_are_of_the_nearest_electrodes_and_depend_on_neither_grid_nor_window():
    totals = weights_at(0.0, 0.0).sum(axis=1)
    below = np.linalg.norm(BIOTAC_SP.layout.positions[:, :2], axis=1)  # distance from the middle of the pad, in plan
    assert np.argmax(totals) in np.argsort(below)[:4]
    assert totals[[0, 9, 10, 19]].max() < 0.05  # tip and end, 10 mm away
    left, right = weights_at(0.2, -0.4).sum(axis=1), weights_at(0.2, 0.4).sum(axis=1)
    assert_allclose(left[[*range(10), 20, 21]], right[[*range(10, 20), 20, 22]], rtol=1e-9)
    coarse, fine = weights_at(0.1, 0.2), weights_at(0.1, 0.2, PAD.replace(cells=96))
    assert_allclose(coarse.sum(axis=1), fine.sum(axis=1), atol=1e-3)
    wide = PAD.replace(window_m=0.03, cells=30)
    weights = weights_at(0.0, 0.9, wide)
    assert np.isfinite(weights).all()
    assert not weights[:, ~np.isfinite(pad_window(wide, pad_direction(0.0, 0.9)).depth).ravel()].any()


def test_the_rim_responds_less_and_closer_skin_raises_the_impedance_exponentially():
    def rise_at(roll, finger=THUMB, displacement_m=1e-6):
        window, shape = pad_window(PAD, pad_direction(0.0, roll)), (PAD.cells, PAD.cells)
        pressed = ContactSolution(np.zeros(shape), np.full((1, *shape), displacement_m), 1.0, 0.0, 0.0)
        return read_contact(PAD, finger, window, pressed)[0] - finger.pdc_rest

    assert rise_at(1.0) == pytest.approx(np.cos(1.0) ** fingertip.RIM_POWER * rise_at(0.0))
    assert rise_at(0.0, replace(THUMB, pdc_span=3.0 * THUMB.pdc_span)) == pytest.approx(3.0 * rise_at(0.0))
    assert rise_at(0.0, displacement_m=1.0) == rise_at(0.0, displacement_m=fingertip.BOTTOMING_M)
    assert rise_at(0.0, displacement_m=-1.0) == 0.0
    counts = fingertip.electrode_counts(np.array([-1e-5, 0.0, fingertip.THINNING_M, 1e-4]), np.full(4, 3500.0))
    assert (np.diff(counts) < 0).all()
    assert_allclose(to_kohm(counts[1:3]) / to_kohm(3500.0), [1.0, np.e], rtol=1e-12)  # the inverse of the formula
    assert_allclose(fingertip.electrode_counts(np.array([-1.0, 1.0]), np.full(2, 3500.0)), [4095.0, 0.0], atol=1e-6)
