# SPDX-License-Identifier: Apache-2.0
"""Adaptation to touches: against Gaussian conditioning of the joint distribution, its limits, its speed."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibrated_models import make_calibration
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import ModelError
from foretouch.models.calibration import GROUPS, Calibration, CalibrationGroup

SIZE = 50


def group_of(between: np.ndarray, within: np.ndarray, worth: float | np.ndarray = 1.0) -> CalibrationGroup:
    return CalibrationGroup(
        between, within, np.broadcast_to(worth, SIZE), np.diag(between) + within, np.full(SIZE, 100.0)
    )


def full(rng: np.random.Generator) -> np.ndarray:
    factors = rng.normal(size=(SIZE, 6))
    return 300.0 * (factors @ factors.T) + 50.0 * np.eye(SIZE)


def conditioned(group: CalibrationGroup, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(50,) mean and variance of an object's lasting error given n residuals, by conditioning the joint Gaussian."""
    n = len(residuals)
    seen = np.kron(np.ones((n, n)), group.between) + np.kron(np.eye(n), np.diag(group.within))
    cross = np.kron(np.ones((1, n)), group.between)
    gain = np.linalg.solve(seen, cross.T).T
    return gain @ residuals.reshape(-1), np.diag(group.between - gain @ cross.T)


@pytest.mark.parametrize("name", ["within", "both", "opposed", "huge"])
def test_a_calibration_that_amplifies_or_is_singular_is_refused(name: str, rng) -> None:
    tensors = make_calibration().to_tensors()
    if name == "within":  # W of one channel vanishes, and B has no part of its own there
        factors = rng.normal(size=(SIZE, 1))
        tensors["new/between"], tensors["new/within"] = 300.0 * factors @ factors.T, np.full(SIZE, 1e-300)
    elif name == "both":
        tensors["new/between"], tensors["new/within"] = np.zeros((SIZE, SIZE)), np.full(SIZE, 5e-324)
    elif name == "opposed":  # a channel without noise stands for one of a million times its size
        pair = np.eye(SIZE)
        pair[:2, :2] = [[1e9, 3.16e3], [3.16e3, 1e-2]]
        tensors["new/between"], tensors["new/within"] = pair, np.full(SIZE, 1e-4)
    else:
        tensors["new/between"] = 1e200 * tensors["new/between"]
    with pytest.raises(ModelError, match=r"^new/between.*(singular|turns residuals|exceeds)"):
        Calibration.from_tensors(tensors)


@pytest.mark.parametrize("touches", [1, 3, 10])
@pytest.mark.parametrize("diagonal", [True, False])
@pytest.mark.parametrize("worth", [1.0, 0.3])
def test_touches_move_predictions_as_conditioning_does(touches: int, diagonal: bool, worth: float, rng) -> None:
    between = np.diag(rng.uniform(10.0, 900.0, SIZE)) if diagonal else full(rng)
    group = group_of(between, rng.uniform(50.0, 900.0, SIZE), worth)
    touched = 3000.0 + 60.0 * rng.normal(size=(touches, SIZE))
    readings = touched + 40.0 * rng.normal(size=(touches, SIZE))
    asked = 3000.0 + 60.0 * rng.normal(size=(4, SIZE))

    def shrunk(counts: np.ndarray) -> np.ndarray:  # towards the touched grasps
        return touched.mean(axis=0) + worth * (counts - touched.mean(axis=0))

    lasting, variance = conditioned(group, readings - shrunk(touched))
    found = group.counts_after(asked, touched.mean(axis=0), readings.mean(axis=0), touches)
    assert_allclose(found, shrunk(asked) + lasting, atol=1e-6)
    wanted = 100.0 * np.sqrt((variance + group.within) / group.spread)
    assert_allclose(group.half_width_after(touches), np.minimum(wanted, 100.0), rtol=1e-9)


def test_without_touches_nothing_changes(rng) -> None:
    group = group_of(full(rng), np.full(SIZE, 400.0), 0.5)
    asked = rng.normal(size=(3, SIZE))
    assert_array_equal(group.counts_after(asked, np.zeros(SIZE), np.zeros(SIZE), 0), asked)
    assert_array_equal(group.half_width_after(0), group.half_width)


def test_residuals_are_applied_fully_for_unbounded_variance_and_not_at_all_for_none(rng) -> None:
    asked, expected, read = rng.normal(3000.0, 50.0, (3, 5, SIZE))
    mean_expected, mean_read = expected.mean(axis=0), read.mean(axis=0)
    residual = mean_read - mean_expected
    wild = group_of(1e12 * np.eye(SIZE), np.full(SIZE, 400.0))
    assert_allclose(wild.counts_after(asked, mean_expected, mean_read, 1), asked + residual, atol=1e-4)
    exact = group_of(full(rng), np.full(SIZE, 1e-9))
    assert_allclose(exact.counts_after(asked, mean_expected, mean_read, 1), asked + residual, atol=1e-4)
    none = group_of(np.zeros((SIZE, SIZE)), np.full(SIZE, 400.0))
    assert_allclose(none.counts_after(asked, mean_expected, mean_read, 5), asked, atol=1e-9)


def test_a_shrinkage_of_zero_leaves_one_prediction_for_all_grasps(rng) -> None:
    group = group_of(full(rng), np.full(SIZE, 400.0), 0.0)
    asked, expected, read = rng.normal(3000.0, 50.0, (3, 5, SIZE))
    after = group.counts_after(asked, expected.mean(axis=0), read.mean(axis=0), 5)
    assert_allclose(after, np.tile(after[0], (5, 1)), atol=1e-9)


def test_many_touches_end_at_what_was_read(rng) -> None:
    group = group_of(full(rng), np.full(SIZE, 400.0))
    asked, expected, read = rng.normal(3000.0, 50.0, (3, 5, SIZE))
    residual = read.mean(axis=0) - expected.mean(axis=0)
    left = [
        np.abs(group.counts_after(asked, expected.mean(axis=0), read.mean(axis=0), n) - asked - residual).max()
        for n in (1, 10, 100, 10**6)
    ]
    assert (np.diff(left) < 0.0).all()
    assert left[-1] < 0.01


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), touches=st.integers(1, 50))
def test_independent_values_move_by_a_part_of_their_residual(seed: int, touches: int) -> None:
    rng = np.random.default_rng(seed)
    between, within = 10.0 ** rng.uniform(-3.0, 4.0, (2, SIZE))
    group = group_of(np.diag(between), within, rng.uniform(0.0, 1.0, SIZE))
    asked, expected, read = rng.normal(3000.0, 200.0, (3, SIZE))
    moved = group.counts_after(asked[None], expected, read, touches)[0] - (expected + group.worth * (asked - expected))
    residual = read - expected
    assert (moved * np.sign(residual) >= -1e-9).all()
    assert (np.abs(moved) <= np.abs(residual) + 1e-9).all()
    assert_allclose(moved, between / (between + within / touches) * residual, atol=1e-8)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), spread=st.floats(0.1, 10.0))
def test_intervals_never_widen_and_narrow_with_each_touch(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    group = group_of(full(rng), 10.0 ** rng.uniform(0.0, 4.0, SIZE))
    group = replace(group, spread=spread * group.spread)
    widths = np.array([group.half_width_after(n) for n in (0, 1, 2, 3, 5, 10, 100)])
    assert (np.diff(widths, axis=0) <= 1e-9).all()
    assert (widths > 0.0).all()


def test_a_correlated_value_is_moved_by_another() -> None:
    """Two values with correlated errors: a residual of one moves the other, by half."""
    between = np.zeros((SIZE, SIZE))
    between[:2, :2] = [[100.0, 50.0], [50.0, 100.0]]
    within = np.full(SIZE, 1e9)
    within[0] = 100.0  # the second is too noisy to contribute
    moved = group_of(between, within).counts_after(np.zeros((1, SIZE)), np.zeros(SIZE), np.eye(SIZE)[0] * 8.0, 1)[0]
    assert_allclose(moved[:2], [4.0, 2.0], atol=1e-5)
    assert_allclose(moved[2:], 0.0, atol=1e-9)


def test_predictions_of_one_call_are_independent_of_each_other(rng) -> None:
    group = make_calibration().groups["new"]
    asked, expected, read = rng.normal(3000.0, 50.0, (3, 40, SIZE))
    means = expected.mean(axis=0), read.mean(axis=0)
    together = group.counts_after(asked, *means, 3)
    assert_array_equal(together, np.concatenate([group.counts_after(one[None], *means, 3) for one in asked]))


def test_touches_cost_less_than_a_millisecond_or_so(rng) -> None:
    group = make_calibration().groups["new"]
    asked, expected, read = rng.normal(3000.0, 50.0, (3, 10, SIZE))
    taken = []
    for _ in range(51):
        start = time.process_time()
        group.counts_after(asked, expected[0], read[0], 3)
        taken.append(time.process_time() - start)
    assert np.median(taken) < 0.005  # 0.001 is expected; CI machines are slow


def test_each_condition_has_its_group() -> None:
    calibration = make_calibration()
    for inside in (True, False):
        for tare in (True, False):
            name = ("known" if inside else "new") + ("_tare" if tare else "")
            assert calibration.group(in_distribution=inside, tare=tare) is calibration.groups[name]
    bare = Calibration(calibration.rest, {name: calibration.groups[name] for name in ("known", "new")})
    assert bare.group(in_distribution=True, tare=True) is bare.groups["known"]
    assert bare.group(in_distribution=False, tare=True) is bare.groups["new"]


@pytest.mark.parametrize("names", [GROUPS, ("known", "new"), ("known", "new", "new_tare")])
def test_tensors_give_it_back_to_the_bit(names: tuple[str, ...], rng) -> None:
    made = make_calibration()
    calibration = Calibration(made.rest, {name: made.groups[name] for name in names})
    again = Calibration.from_tensors(calibration.to_tensors())
    assert set(again.groups) == set(names)
    asked = rng.normal(3000.0, 50.0, (3, SIZE))
    for name in names:
        for after in (again.groups[name], calibration.groups[name]):
            assert after.half_width_after(2).shape == (SIZE,)
        assert_array_equal(again.groups[name].half_width_after(2), calibration.groups[name].half_width_after(2))
        args = (asked, calibration.rest, calibration.rest + 9.0, 2)
        assert_array_equal(again.groups[name].counts_after(*args), calibration.groups[name].counts_after(*args))


def changed(array: np.ndarray, index: Any, value: float) -> np.ndarray:
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("name", "change", "rule"),
    [
        ("rest", lambda a: None, "rest: is missing"),
        ("rest", lambda a: changed(a, 3, np.nan), "rest: holds a value that is not finite$"),
        ("new/between", lambda a: None, "new/between: is missing"),
        ("known_tare/worth", lambda a: None, "known_tare/worth: is missing"),
        ("known/between", lambda a: a[:, :49], r"known/between: shape \(50, 49\) is not \(50, 50\)"),
        ("known/within", lambda a: a[:2], r"known/within: shape \(2,\) is not \(50,\)"),
        ("known/within", lambda a: changed(a, 0, 0.0), "known/within: .* not finite and above 0"),
        ("new/spread", lambda a: changed(a, 0, -1.0), "new/spread: .* not finite and above 0"),
        ("new/half_width", lambda a: changed(a, 49, np.inf), "new/half_width: .* not finite and above 0"),
        ("new_tare/between", lambda a: changed(a, (0, 1), 1e6), "new_tare/between: is not symmetric"),
        ("new/between", lambda a: -a, "new/between: is no covariance"),
        ("new/worth", lambda a: changed(a, 5, 1.5), r"new/worth: leaves \[0, 1\]"),
        ("new/worth", lambda a: changed(a, 5, -0.1), r"new/worth: leaves \[0, 1\]"),
    ],
)
def test_damage_is_refused_by_name(name: str, change: Any, rule: str) -> None:
    tensors = make_calibration().to_tensors()
    tensors[name] = change(tensors[name])
    if tensors[name] is None:
        del tensors[name]
    with pytest.raises(ModelError, match=rule):
        Calibration.from_tensors(tensors)


def test_the_parameters_of_a_tracker_are_stored_beside_the_groups() -> None:
    calibration = make_calibration()
    assert not any(name.startswith("tracker/") for name in calibration.to_tensors())
    fitted = replace(calibration, tracker=calibration.tracker_parameters())
    again = Calibration.from_tensors(fitted.to_tensors())
    for name, array in fitted.to_tensors().items():
        assert_array_equal(again.to_tensors()[name], array)
    damaged = fitted.to_tensors() | {"tracker/slow": np.full(SIZE, np.nan)}
    with pytest.raises(ModelError, match=r"^tracker/slow: "):
        Calibration.from_tensors(damaged)
