# SPDX-License-Identifier: Apache-2.0
"""The gain of a kernel on new objects: shares known by hand, and that heavy objects do not decide."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.tactile import BIOTAC
from foretouch_lab.learning.training.contact import _RIDGES, choose_ridge, shrunken_slope


def made(rng: np.random.Generator, carries_over: float, count: int = 10) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Rows and standardised labels of objects, of which a share follows from the row and the rest is an object's own."""
    objects = [f"o{k // 12}" for k in range(12 * count)]
    rows = rng.normal(size=(len(objects), 12)) + np.repeat(rng.normal(size=(count, 12)), 12, axis=0)
    labels = carries_over * rows @ rng.normal(size=(12, 50)) / np.sqrt(12.0)
    labels += (1.0 - carries_over) * np.repeat(rng.normal(size=(count, 50)), 12, axis=0)
    labels += 0.3 * rng.normal(size=labels.shape)
    return rows, (labels - labels.mean(axis=0)) / labels.std(axis=0), objects


@pytest.mark.slow
def test_what_generalises_has_a_gain_each_object_weighs_the_same_and_a_single_one_has_none(rng) -> None:
    """A slope that is zero exceeds its own standard error, above which there is a gain, in one of six draws."""
    found = {share: [choose_ridge(*made(rng, share), BIOTAC) for _ in range(30)] for share in (0.0, 1.0)}
    assert all(ridge < max(_RIDGES) and (gain > 0.7).all() for ridge, gain in found[1.0])
    assert np.mean([gain > 0.3 for _, gain in found[0.0]]) < 0.35  # 120 draws, four of a set not independent
    rows, labels, _ = made(rng, 1.0)
    ridge, gain = choose_ridge(rows, labels, ["only"] * len(rows), BIOTAC)
    assert ridge == max(_RIDGES)
    assert_array_equal(gain, np.zeros(4))
    gains = []
    for _ in range(10):
        rows, labels, objects = made(rng, 1.0)
        assert_allclose(choose_ridge(rows, labels, objects, BIOTAC)[1], 1.0, atol=0.3)
        labels[np.array(objects) == "o0"] *= 30.0
        gains.append(choose_ridge(rows, labels, objects, BIOTAC)[1])
    assert np.mean(gains) < 0.9  # of one set, one draw in thirty leaves all at 1


def test_slope_and_jackknife_by_hand() -> None:
    """Three objects: slope (1 + 2 + 3) / (2 + 2 + 2) = 1; without each 5/4, 4/4, 3/4, whose jackknife variance is 2/3 · 1/8."""
    assert shrunken_slope(np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 2.0])) == pytest.approx(1.0 - 1.0 / 12.0)
    agreeing = shrunken_slope(np.full(8, 0.5), np.full(8, 1.0))
    assert agreeing == pytest.approx(0.5)
    heavy = np.append(np.zeros(7), 4.0)
    assert shrunken_slope(heavy, np.full(8, 1.0)) == 0.0  # all of it is from one
    assert shrunken_slope(-heavy, np.full(8, 1.0)) == 0.0
    assert shrunken_slope(np.zeros(8), np.zeros(8)) == 0.0
