# SPDX-License-Identifier: Apache-2.0
"""A calibration: the tracker that follows from it against Gaussian conditioning, its intervals, its file."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from calibrated_models import REST, make_calibration, make_tracked_calibration
from every_case import every_case
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.dataset.formats.vision2tactile import read_touch
from foretouch.errors import ModelError
from foretouch.models import load_model
from foretouch.models.calibration import GROUPS, Calibration, CalibrationGroup
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC, biotac_touch

SIZE = 50
Change = Callable[[np.ndarray], np.ndarray | None]


def group_of(between: np.ndarray, within: np.ndarray, difference_shrinkage: float) -> CalibrationGroup:
    return CalibrationGroup(
        BIOTAC, between, within, np.full(SIZE, difference_shrinkage), np.diag(between) + within, np.full(SIZE, 100.0)
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


def test_touches_move_predictions_as_conditioning_does(rng) -> None:
    def check(between: np.ndarray, touches: int, difference_shrinkage: float, known: bool) -> None:
        group = group_of(between, rng.uniform(50.0, 900.0, SIZE), difference_shrinkage)
        # Of known objects, only the diagonals in the basis of new ones are used: both have the same group here.
        parameters = Calibration(BIOTAC, REST, {"known": group, "new": group}).tracker_parameters
        tracker = SensorTracker(replace(parameters, alarm=np.full((2, 2), 1e6)))
        tracker.start_object(known=known)
        touched, readings = 3000.0 + 60.0 * rng.normal(size=(2, touches, SIZE))
        asked = 3000.0 + 60.0 * rng.normal(size=(4, SIZE))
        for reading, expected in zip(readings, touched, strict=True):
            tracker.add_touch(5, reading, expected)
        mean = touched.mean(axis=0) if touches else asked
        found, _ = tracker.adapt(tracker.level(5), asked)
        moved, variance = conditioned(group, readings - mean) if touches else (0.0, np.diag(between))
        shrunk = mean + (difference_shrinkage if touches else 1.0) * (asked - mean)
        # The residuals that B (B + W/n)^-1 acts on are those of the mean, so shrunk differences cancel in it.
        assert_allclose(found, shrunk + moved, atol=1e-6)
        assert_allclose(tracker.level(5).variance, variance, rtol=1e-7)

    kinds = (("diagonal", np.diag(rng.uniform(10.0, 900.0, SIZE))), ("full", full(rng)))
    cases = product(kinds, (0, 1, 3, 10), (1.0, 0.3), (False, True))
    every_case({f"{kind[0]} B, {rest}": (kind[1], *rest) for kind, *rest in cases}, check)


def test_what_lasts_on_known_objects_too_is_of_the_sensors() -> None:
    groups = make_calibration().groups
    small = replace(groups["new"], between=0.3 * groups["new"].between)
    parameters = Calibration(BIOTAC, REST, {"known": small, "new": groups["new"]}).tracker_parameters
    lasting = parameters.object + parameters.slow
    assert_allclose(parameters.slow, 0.3 * lasting[0], rtol=1e-9)
    assert_allclose(parameters.object[1], 0.0, atol=1e-9)
    assert_allclose(parameters.basis @ np.diag(lasting[0]) @ parameters.basis.T, groups["new"].between, rtol=1e-9)


def test_a_tracker_without_a_fit_has_the_half_widths_over_deviations_of_either_group() -> None:
    new = make_calibration().groups["new"]
    known = replace(new, half_width=0.8 * new.half_width)
    tracker = SensorTracker(Calibration(BIOTAC, REST, {"known": known, "new": new}).tracker_parameters)
    for name, group in (("known", known), ("new", new)):
        _, half = tracker.adapt(tracker.level(0, same_object=False, known=name == "known"), REST[None])
        assert_allclose(half[0], group.half_width, rtol=1e-9)


def test_before_any_reading_intervals_are_conformal_or_those_of_the_fitted_tracker() -> None:
    plain, tracked = make_calibration(), make_tracked_calibration()
    for one in (plain, tracked):
        again = Calibration.from_tensors(one.to_tensors(), BIOTAC).to_tensors()
        assert again.keys() == one.to_tensors().keys()
        for name, array in one.to_tensors().items():
            assert_array_equal(again[name], array)
    for name in GROUPS:
        assert_array_equal(plain.unread_half_widths[name], plain.groups[name].half_width)
        tracker = SensorTracker(tracked.tracker)
        tracker.start_object(known=name == "known")
        assert_array_equal(tracked.unread_half_widths[name], tracker.adapt(tracker.level(7), REST[None])[1][0])


def changed(index: int | tuple[int, int], value: float) -> Change:
    def change(array: np.ndarray) -> np.ndarray:
        array = array.copy()
        array[index] = value
        return array

    return change


def test_damage_is_refused_by_name() -> None:
    def check(name: str, change: Change, rule: str) -> None:
        tensors = make_tracked_calibration().to_tensors()
        if (value := change(tensors.pop(name))) is not None:
            tensors[name] = value
        with pytest.raises(ModelError, match=rule):
            Calibration.from_tensors(tensors, BIOTAC)

    cases = [
        ("rest", changed(3, np.nan), "rest: is missing, .* or not finite$"),
        ("new/between", lambda a: None, "new/between: is missing"),
        ("known/between", lambda a: a[:, :49], r"known/between: shape \(50, 49\) is not \(50, 50\)"),
        ("known/within", changed(0, 5e-324), r"known/within: .* not within \[1e-09"),
        ("new/half_width", changed(49, np.inf), r"new/half_width: .* not within \[1e-09"),
        ("new/between", changed((0, 1), 1e6), "new/between: is not symmetric"),
        ("new/between", lambda a: -a, "new/between: is not a covariance"),
        ("new/between", lambda a: 1e200 * a, r"new/between: .* not within \[-1e.12"),
        ("new/difference_shrinkage", changed(5, 1.5), r"new/difference_shrinkage: .* not within \[0, 1\]"),
        ("tracker/slow", changed(5, np.nan), "^tracker/slow: "),
    ]
    every_case(cases, check)


def test_a_calibration_that_amplifies_is_refused() -> None:
    """A channel almost without noise stands for one of ten thousand times its size."""
    tensors = make_calibration().to_tensors()
    tensors["new/between"] = np.eye(SIZE)
    tensors["new/between"][:2, :2] = [[1e6, 9.9e1], [9.9e1, 1e-2]]
    tensors["new/within"] = np.r_[1e6, 1e-3, np.ones(SIZE - 2)]
    with pytest.raises(ModelError, match=r"^between, within: no tracker can be made of them: .* 10 is allowed"):
        Calibration.from_tensors(tensors, BIOTAC)


def test_readings_in_contact_are_found_and_what_drifts_at_rest_is_not(rng: np.random.Generator, request) -> None:
    calibration = load_model("contact-v3").calibration
    assert calibration is not None
    tracker = calibration.tracker_parameters
    drift = (rng.normal(size=(500, SIZE)) * np.sqrt(tracker.slow + tracker.fast)) @ tracker.basis.T
    found = [bool(calibration.contact_signs(biotac_touch(row))) for row in calibration.rest + drift]
    assert np.mean(found) < 0.02
    paths = sorted((request.getfixturevalue("real_data") / "vision2tactile").rglob("*.tac"))
    touched = [bool(calibration.contact_signs(read_touch(path)[0])) for path in paths]
    assert len(touched) >= 400
    assert np.mean(touched) > 0.98
