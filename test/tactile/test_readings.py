# SPDX-License-Identifier: Apache-2.0
"""Readings: faults, tare, and units against numbers worked out by hand."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import TactileError
from foretouch.tactile.readings import (
    check_series,
    check_touch,
    make_tare,
    offsets,
    restore,
    to_celsius,
    to_kohm,
    to_kpa,
    to_pa,
)
from foretouch.types import Touch

REST = Touch(2779.0, 1676.0, np.full(24, 3300.0), np.full(24, 3500.0))


def test_a_reading_at_rest_is_valid() -> None:
    check = check_touch(REST)
    assert check.valid
    assert check.out_of_range == ()
    check.require()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"e_th": np.zeros(24)}, "e_th: all 24 electrodes are 0, an absent sensor"),
        ({"pdc_mf": -22072.0}, "pdc_mf: -22072 is not between 0 and 4095"),
        ({"pdc_th": -9784.0}, "pdc_th: -9784 is not"),
        ({"pdc_th": float("nan")}, "pdc_th: nan is not"),
        ({"e_mf": np.r_[np.full(23, 3500.0), 5000.0]}, r"e_mf\[23\]: 5000 is not .* \(1 such"),
        ({"e_mf": np.r_[np.nan, np.full(23, 3500.0)]}, r"e_mf\[0\]: nan"),
    ],
)
def test_faults_are_named(change, message: str) -> None:
    check = check_touch(dataclasses.replace(REST, **change))
    assert not check.valid
    with pytest.raises(TactileError, match=message):
        check.require()


def test_all_faults_are_reported_at_once() -> None:
    with pytest.raises(TactileError, match=r"pdc_th.*; e_mf"):
        check_touch(dataclasses.replace(REST, pdc_th=-1.0, e_mf=np.zeros(24))).require()


def test_out_of_range_is_a_flag_only() -> None:
    check = check_touch(dataclasses.replace(REST, pdc_th=3500.0, e_mf=np.full(24, 3900.0)))
    assert check.valid
    assert check.out_of_range == ("PDC_TH", "E_MF")


def test_a_pdc_that_never_moves_is_dead() -> None:
    assert "constant at 1676 over 3000" in check_series(np.full(3000, 1676.0)).faults[0]
    assert check_series(np.r_[np.full(3000, 1676.0), 1677.0]).valid
    assert check_series(np.full(100, 1676.0)).valid  # too short to judge


def test_tare_is_the_median_and_offsets_invert() -> None:
    noisy = [dataclasses.replace(REST, pdc_th=v) for v in (2779.0, 2780.0, 3300.0)]
    tare = make_tare(noisy)
    assert tare.pdc_th == 2780.0
    touch = dataclasses.replace(REST, pdc_th=2900.0, e_th=REST.e_th - 100)
    assert_allclose(offsets(touch, tare)[[0, 1, 2]], [120.0, 0.0, -100.0])
    assert_allclose(restore(offsets(touch, tare), tare).vector(), touch.vector())


def test_bad_tare_is_refused() -> None:
    with pytest.raises(TactileError, match="tare: no reading"):
        make_tare([])
    with pytest.raises(TactileError, match="tare: reading 1: e_mf: all 24"):
        make_tare([REST, dataclasses.replace(REST, e_mf=np.zeros(24))])


def test_pressure_rises_with_pdc() -> None:
    assert to_kpa(1776, 1676) == pytest.approx(3.65)
    assert_allclose(to_kpa([1676, 1675], 1676), [0.0, -0.0365], atol=1e-12)


def test_vibration() -> None:
    assert to_pa(2058, 2048) == pytest.approx(3.7)


def test_impedance() -> None:
    # E at half scale: (2 - 1) * 10; at a quarter (4 - 1) * 10; at full scale none
    assert_allclose(to_kohm([4095 / 2, 4095 / 4, 4095]), [10.0, 30.0, 0.0], atol=1e-12)


def test_compression_raises_impedance() -> None:
    assert np.all(np.diff(to_kohm(np.arange(1, 4096))) < 0)


def test_temperature_by_hand() -> None:
    # x = 0.5: ln((155183 - 23277.5) / 0.5) = ln(263811) = 12.48299; 4025 / 12.48299 = 322.4387 K
    assert to_celsius(4095 / 2) == pytest.approx(49.2887, abs=2e-3)


def test_temperature_is_monotone_and_finite() -> None:
    celsius = to_celsius(np.arange(1, 4096))
    assert np.isfinite(celsius).all()
    assert np.all(np.diff(celsius) > 0)


@pytest.mark.parametrize(
    ("convert", "message"),
    [
        (lambda: to_kohm(0), "electrode: 0 is not above 0 and at most 4095"),
        (lambda: to_kohm([100, 4096]), "electrode: 4096 is not above 0"),
        (lambda: to_kohm(np.nan), "electrode: nan is not"),
        (lambda: to_celsius(0), "tdc: 0 is not above 0"),
        (lambda: to_kpa(-22072, 1676), "pdc: -22072 is not at least 0"),
        (lambda: to_kpa(1700, np.inf), "offset: inf is not"),
    ],
)
def test_outside_the_domain_is_refused(convert, message: str) -> None:
    with pytest.raises(TactileError, match=message):
        convert()
