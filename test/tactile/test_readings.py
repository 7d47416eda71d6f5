# SPDX-License-Identifier: Apache-2.0
"""Readings: faults, tare, and impedances against numbers worked out by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import TactileError
from foretouch.tactile import BIOTAC, biotac_touch, make_tare, tdc_of, to_kohm, touch_faults
from foretouch.tactile.description import packaged_sensor
from foretouch.types import Touch

REST = biotac_touch(np.hstack([2779.0, 1676.0, np.full(24, 3300.0), np.full(24, 3500.0)]))


def changed(**modalities: Any) -> Touch:
    """The reading with some modalities replaced."""
    values = REST.values.copy()
    for name, new in modalities.items():
        values[BIOTAC.columns([name.upper()])] = new
    return biotac_touch(values)


def test_faults_are_named_all_at_once() -> None:
    def check(change: dict[str, Any], *messages: str) -> None:
        faults = touch_faults(changed(**change))
        assert all(fault.startswith(message) for fault, message in zip(faults, messages, strict=True))

    cases = [
        ({},),
        ({"pdc_th": 3500.0, "e_mf": np.full(24, 3900.0)},),  # out of P2's ranges
        ({"e_th": 0.0}, "e_th: all 24 values are 0, an absent sensor"),
        ({"pdc_mf": -22072.0}, "pdc_mf: -22072 is not between 1 and 4095"),
        ({"pdc_th": -9784.0}, "pdc_th: -9784 is not"),
        ({"pdc_th": float("nan")}, "pdc_th: was not read"),
        (
            {"e_mf": np.r_[np.full(12, 3500.0), np.full(12, 5000.0)]},
            "e_mf[12]: 5000 is not between 1 and 4095 counts (12 such",
        ),
        ({"e_mf": np.r_[np.full(12, np.nan), np.full(12, 3500.0)]}, "e_mf[0]: nan"),
        ({"e_mf": np.r_[np.nan, 0.0, np.full(22, 3500.0)]},),  # single dead electrodes
        ({"pdc_th": -1.0, "e_mf": 0.0}, "pdc_th: -1", "e_mf: all 24"),
    ]
    every_case(cases, check)


def test_tare_is_the_median() -> None:
    tare = make_tare([changed(pdc_th=v) for v in (2779.0, 2780.0, 3300.0)])
    assert tare["PDC_TH"][0] == 2780.0
    with pytest.raises(TactileError, match="tare: no reading"):
        make_tare([])
    with pytest.raises(TactileError, match="tare: reading 1: e_mf: all 24"):
        make_tare([REST, changed(e_mf=0.0)])


def test_impedance_by_hand() -> None:
    # E at half scale: (2 - 1) * 10; at a quarter (4 - 1) * 10; at full scale none
    assert_allclose(to_kohm([4095 / 2, 4095 / 4, 4095]), [10.0, 30.0, 0.0], atol=1e-12)
    assert np.all(np.diff(to_kohm(np.arange(1, 4096))) < 0)  # compression lowers E
    for counts, message in ((0, "0 is not above 0 and at most 4095"), ([100, 4096], "4096 is not"), (np.nan, "nan is")):
        with pytest.raises(TactileError, match=f"electrode: {message}"):
            to_kohm(counts)


def test_the_tare_of_a_channel_whose_rest_level_is_zero_is_zero(rng: np.random.Generator) -> None:
    channels = packaged_sensor("tacsl_20x25").channels
    readings = [Touch(rng.normal(0.0, 0.01, channels.size), channels) for _ in range(5)]
    assert not make_tare(readings).values.any()
    counts = rng.integers(1, 4095, (5, BIOTAC.size)).astype(float)
    tare = make_tare([Touch(count, BIOTAC) for count in counts])
    np.testing.assert_array_equal(tare.values, np.median(counts, axis=0))


def test_temperatures_are_those_of_the_fingers_of_the_touch() -> None:
    extra = {"TDC_TH": 2400.0, "TDC_FF": 2500.0, "tare_TDC_FF": 4095.0, "TDC_MF": 0.0}
    other = replace(BIOTAC, fingers=("TH", "FF"))
    assert_array_equal(tdc_of(extra, other), [2400.0, 2500.0])
    assert_array_equal(tdc_of(extra, BIOTAC), [2400.0, np.nan])  # 0: a driver without one
    assert_array_equal(tdc_of(extra, other, "tare_"), [np.nan, np.nan])  # absent, saturated
