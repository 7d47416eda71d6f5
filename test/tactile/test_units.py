# SPDX-License-Identifier: Apache-2.0
"""Units against numbers worked by hand, and the ends of the formulas' domains."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import TactileError
from foretouch.tactile.units import to_celsius, to_kohm, to_kpa, to_pa


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
