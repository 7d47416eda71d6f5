# SPDX-License-Identifier: Apache-2.0
"""The tracker: against conditioning of the joint Gaussian, jumps, pauses, bad input, restarts, its cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated_models import REST, make_calibration
from every_case import every_case
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import ModelError, TactileError
from foretouch.models.state_space import TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC

SIZE, S, DAY = 50, 10**9, 86400 * 10**9
START = 1_700_000_000 * S
PARAMETERS = make_calibration().tracker_parameters
PATIENT = replace(PARAMETERS, alarm=np.full((2, 2), 1e6))  # never restarts a finger


def drifting(slow: float = 2.0, fast: float = 0.5, lasting: float = 0.5) -> TrackerParameters:
    """Independent values with a deviation of the noise of 20 counts, and a slow and a fast state."""
    ones = np.ones(SIZE)
    return replace(
        PARAMETERS,
        basis=20.0 * np.eye(SIZE),
        slow=slow * ones,
        fast=fast * ones,
        object=np.full((2, SIZE), lasting),
        noise=np.ones((2, SIZE)),
        difference_shrinkage=np.ones((2, SIZE)),
        factor=np.full(4, 1.645),
    )


def touch(tracker: SensorTracker, second: float, residual: np.ndarray) -> tuple[str, ...]:
    return tracker.add_touch(START + int(second * 1e9), REST + residual, REST)


def conditioned(
    parameters: TrackerParameters,
    seconds: np.ndarray,
    objects: list[int],
    tares: list[bool],
    values: np.ndarray,
    at: float,
    of: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of the level at a time, by conditioning the joint Gaussian of all readings; all coordinates alike."""

    touched = ~np.array(tares)

    def covariance(t1: np.ndarray, t2: np.ndarray, both: np.ndarray) -> np.ndarray:
        gap = np.abs(t1[:, None] - t2[None])
        fast = parameters.fast[0] * np.exp(-gap / parameters.fast_time_s[0])
        return parameters.slow[0] * np.exp(-gap / parameters.slow_time_s[0]) + fast * both

    same = np.equal.outer(objects, objects) & np.outer(touched, touched)
    noise = np.where(touched, 1.0, parameters.tare_noise[0])
    seen = covariance(seconds, seconds, np.outer(touched, touched)) + parameters.object[0, 0] * same + np.diag(noise)
    now = np.array([at])
    cross = covariance(now, seconds, touched)[0] + parameters.object[0, 0] * (np.array(objects) == of) * touched
    gain = np.linalg.solve(seen, cross)
    variance = parameters.slow[0] + parameters.fast[0] + parameters.object[0, 0] - gain @ cross
    return gain @ values, np.full(SIZE, 400.0 * variance)


def test_the_level_is_that_of_the_joint_gaussian(rng) -> None:
    parameters = replace(drifting(), alarm=PATIENT.alarm)
    tracker = SensorTracker(parameters)
    seconds = np.cumsum(rng.choice([70.0, 300.0, 4000.0, 3.0e5], 30))
    objects = list(np.cumsum(rng.random(30) < 0.2))
    tares = list(rng.random(30) < 0.2)
    values = rng.normal(0.0, 40.0, (30, SIZE))
    current = objects[0]
    for second, name, tare, value in zip(seconds, objects, tares, values, strict=True):
        if name != current:
            tracker.start_object()
            current = name
        stamp = START + int(second * 1e9)
        if tare:
            tracker.add_tare(stamp, value)
        else:
            tracker.add_touch(stamp, REST + value, REST)
    at = seconds[-1] + 500.0
    for of, same in ((objects[-1], True), (-1, False)):
        level = tracker.level(START + int(at * 1e9), same_object=same)
        mean, variance = conditioned(parameters, seconds, objects, tares, values, at, of)
        assert_allclose(level.offset, mean, atol=1e-6)
        assert_allclose(level.variance, variance, rtol=1e-6)
    assert level.evidence.readings == 30
    assert level.evidence.reading_age_s == pytest.approx(500.0)


def test_a_jump_of_one_finger_is_noticed_and_restarts_that_finger_alone(rng) -> None:
    def check(finger: str, values: np.ndarray) -> None:
        tracker = SensorTracker(drifting(slow=1.0, fast=0.1))
        for k in range(30):
            assert touch(tracker, 60.0 * k, rng.normal(0.0, 20.0, SIZE)) == ()
        jump = np.zeros(SIZE)
        jump[values] = -100.0
        before = tracker.level(START + 1800 * S)
        assert touch(tracker, 1800.0, jump + rng.normal(0.0, 20.0, SIZE)) == ()  # one odd grasp is not used
        assert_allclose(tracker.level(START + 1800 * S).offset[values], before.offset[values], atol=2.0)
        assert touch(tracker, 1860.0, jump + rng.normal(0.0, 20.0, SIZE)) == (finger,)
        after = tracker.level(START + 1860 * S)
        assert (after.variance[values] > 2.0 * before.variance[values]).all()
        assert after.offset[values].mean() < -50.0
        others = np.setdiff1d(np.arange(SIZE), values)
        assert_allclose(after.variance[others], before.variance[others], rtol=0.1)

    every_case(zip(BIOTAC.fingers, (np.r_[0, 2:26], np.r_[1, 26:50]), strict=True), check)
    tracker = SensorTracker(drifting())  # a tare restarts an exchanged finger at once
    assert tracker.add_tare(START, np.zeros(SIZE)) == ()
    offset = np.where(np.isin(np.arange(SIZE), np.r_[1, 26:50]), 400.0, 0.0)
    assert tracker.add_tare(START + DAY, offset) == ("MF",)
    assert_allclose(tracker.level(START + DAY).offset[26:], 400.0, rtol=0.1)


def test_a_hand_far_from_the_rest_level_of_the_model_is_restarted_once(rng) -> None:
    """What is a hundred times as far as the sensors of the training is believed from the first tare on."""
    tracker, far = SensorTracker(drifting()), rng.normal(0.0, 5000.0, SIZE)
    assert tracker.add_tare(START, far) == BIOTAC.fingers
    assert_allclose(tracker.level(START).offset, far, rtol=0.02, atol=20.0)
    for k in range(1, 20):
        assert tracker.add_tare(START + 120 * k * S, far + rng.normal(0.0, 5.0, SIZE)) == ()


def test_intervals_return_to_their_coverage_after_a_change(rng) -> None:
    tracker, restarts = SensorTracker(drifting(slow=0.0, fast=0.0, lasting=0.0)), 0
    for k in range(1000):  # readings as modelled restart a finger as rarely as stated
        restarts += len(touch(tracker, 60.0 * k, rng.normal(0.0, 20.0, SIZE)))
    assert restarts <= 2
    tracker = SensorTracker(replace(drifting(slow=0.0, fast=0.0, lasting=0.0), alarm=PATIENT.alarm))
    inside = []
    for k in range(600):
        residual = rng.normal(0.0, 20.0 if k < 200 else 50.0, SIZE)
        counts, half = tracker.adapt(tracker.level(START + k * 60 * S), REST[None])
        inside.append(np.abs(REST + residual - counts[0]) <= half[0])
        touch(tracker, 60.0 * k, residual)
    inside = np.array(inside)
    assert abs(inside[:200].mean() - 0.9) < 0.03
    assert inside[200:210].mean() < 0.7
    for values in (np.r_[2:26], np.r_[26:50]):
        assert abs(inside[300:, values].mean() - 0.9) < 0.03
    assert abs(inside[300:, :2].mean() - 0.9) < 0.05


@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(["tare", "touch", "object", "known"]), st.integers(0, 10**6), st.integers(0, 99)),
        max_size=25,
    ),
    st.integers(0, 25),
)
def test_a_restart_in_the_middle_is_bit_equal_to_none(events: list[tuple[str, int, int]], cut: int) -> None:
    def play(tracker: SensorTracker, part: list[tuple[str, int, int]], second: int) -> int:
        for kind, pause, seed in part:
            second += pause
            value = np.random.default_rng(seed).normal(0.0, 80.0, SIZE)
            if kind == "tare":
                tracker.add_tare(START + second * S, value)
            elif kind == "touch":
                touch(tracker, second, value)
            else:
                tracker.start_object(known=kind == "known")
        return second

    one = SensorTracker(drifting())
    play(one, events, 0)
    first = SensorTracker(drifting())
    second = play(first, events[:cut], 0)
    other = SensorTracker.from_tensors(drifting(), first.to_tensors())
    second = play(other, events[cut:], second)
    for name, array in one.to_tensors().items():
        assert_array_equal(array, other.to_tensors()[name], err_msg=name)
    for same in (True, False):
        for left, right in zip(
            *(one_.adapt(one_.level(START + second * S, same_object=same), REST[None]) for one_ in (one, other)),
            strict=True,
        ):
            assert_array_equal(left, right)


def test_stamps_and_readings_that_cannot_be_are_refused_and_change_nothing() -> None:
    tracker = SensorTracker(drifting())
    touch(tracker, 0.0, np.zeros(SIZE))
    before = tracker.to_tensors()

    def check(rule: str, stamp: float, reading: np.ndarray = REST) -> None:
        with pytest.raises(TactileError, match=f"^{rule}"):
            tracker.add_touch(stamp, reading, REST)
        if rule.startswith("stamp"):
            with pytest.raises(TactileError, match=f"^{rule}"):
                tracker.add_tare(stamp, np.zeros(SIZE))
        for name, array in tracker.to_tensors().items():
            assert_array_equal(array, before[name])

    spoiled = [np.where(np.arange(SIZE) == 7, value, REST) for value in (np.inf, -1.0, 4096.0)]
    spoiled += [
        np.where(unread, np.nan, REST) for unread in (np.arange(SIZE) == 0, np.isin(np.arange(SIZE), range(2, 14)))
    ]
    every_case(
        [
            ("stamp: .*61.0 s before that of the newest reading", START - 61 * S),
            *(("stamp: .*is not nanoseconds", stamp) for stamp in (-1, 1.5, 2**63, True)),
            *(("reading: value", START, reading) for reading in spoiled),
            ("reading: shape", START, REST[:7]),
        ],
        check,
    )


def test_parameters_that_cannot_be_are_refused_by_name() -> None:
    local = replace(PARAMETERS, where_scale=np.ones(5), where_ratio=np.ones(4))
    again = TrackerParameters.from_tensors(local.to_tensors(), channels=BIOTAC)
    for name, array in local.to_tensors().items():
        assert_array_equal(again.to_tensors()[name], array)

    def check(name: str, harm: str) -> None:
        tensors = {key: array.copy() for key, array in local.to_tensors().items()}
        if harm in HARM:
            tensors[name].flat[3] = HARM[harm]
        elif harm == "shape":
            tensors[name] = tensors[name][None] if name == "where_scale" else tensors[name][:1]  # of any length
        else:
            del tensors[name]
        with pytest.raises(ModelError, match=f"^{name}: "):
            TrackerParameters.from_tensors(tensors, channels=BIOTAC)

    # Of models that were fitted without temperatures or features.
    optional = ("slope", "slope_sd", "where_scale", "where_ratio")
    harms = {name: (*HARM, "shape", *("missing",) * (name not in optional)) for name in again.to_tensors()}
    every_case([(name, harm) for name, found in harms.items() for harm in found], check)


HARM = {"nan": np.nan, "negative": -1e12, "huge": 1e12}


def test_a_singular_or_amplifying_basis_is_refused() -> None:
    with pytest.raises(ModelError, match=r"^basis: is singular"):
        TrackerParameters.from_tensors(replace(PARAMETERS, basis=np.ones((SIZE, SIZE))).to_tensors(), channels=BIOTAC)
    skewed = np.eye(SIZE) * 20.0
    skewed[0, 1] = 1e5
    with pytest.raises(ModelError, match=r"^basis, object: [0-9]+ touches turn .* 10 is allowed"):
        TrackerParameters.from_tensors(replace(PARAMETERS, basis=skewed).to_tensors(), channels=BIOTAC)


def test_a_state_that_cannot_be_is_refused_by_name() -> None:
    tracker = SensorTracker(drifting())
    touch(tracker, 0.0, np.zeros(SIZE))

    def check(name: str, harm: str) -> None:
        tensors = {key: array.copy() for key, array in tracker.to_tensors().items()}
        if harm == "missing":
            del tensors[name]
        elif harm == "shape":
            tensors[name] = tensors[name][..., :1]
        elif tensors[name].dtype.kind == "f":
            tensors[name].flat[0] = HARM[harm]
        else:
            tensors[name].flat[0] ^= np.array(1, tensors[name].dtype) << 6
            if name == "stamps_ns":
                tensors[name] = -2 - np.abs(tensors[name])
        with pytest.raises(ModelError, match=name):
            SensorTracker.from_tensors(drifting(), tensors)

    every_case([(name, harm) for name in tracker.to_tensors() for harm in (*HARM, "shape", "missing")], check)
    with pytest.raises(ModelError, match=r"^parameters: are those of another model"):
        SensorTracker.from_tensors(drifting(slow=3.0), tracker.to_tensors())


def thermal(slope: float = 0.6, deviation: float = 0.2) -> TrackerParameters:
    """As `drifting`, with electrodes that follow the temperature."""
    electrodes = np.where(np.arange(SIZE) < 2, 0.0, 1.0)
    return replace(drifting(), slope=slope * electrodes, slope_sd=deviation * electrodes)


def readings_with_tdc(rng: np.random.Generator, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """(S, 50) residuals of sensors with a slope of .6 for the thumb and .4 for the middle finger, and (S, 2) TDC."""
    tdc = 2400.0 + np.cumsum(rng.normal(0.0, 20.0, (count, 2)), axis=0)
    slopes = np.concatenate([[0.0, 0.0], np.full(24, 0.6), np.full(24, 0.4)])
    of_finger = np.concatenate([[0, 1], np.zeros(24, int), np.ones(24, int)])
    return slopes * (tdc - tdc[0])[:, of_finger] + rng.normal(0.0, 5.0, (count, SIZE)), tdc


def played(parameters: TrackerParameters, residuals: np.ndarray, tdc: np.ndarray | None) -> tuple[SensorTracker, list]:
    """A tracker after all readings, and the offset that it predicted before each, with the temperature known."""
    tracker, offsets = SensorTracker(parameters), []
    for k, residual in enumerate(residuals):
        row = None if tdc is None else tdc[k]
        offsets.append(tracker.level(START + k * S, tdc=row).offset)
        tracker.add_touch(START + k * S, REST + residual, REST, tdc=row)
    return tracker, offsets


def test_readings_are_explained_by_the_temperature(rng) -> None:
    residuals, tdc = readings_with_tdc(rng)
    errors = {}
    for name, parameters, row in (("with", thermal(), tdc), ("without", drifting(), None)):
        _, offsets = played(parameters, residuals, row)
        errors[name] = np.sqrt(np.mean((residuals - offsets)[5:, 2:] ** 2))
    assert errors["with"] < 0.7 * errors["without"]
    again = SensorTracker.from_tensors(thermal(), played(thermal(), residuals, tdc)[0].to_tensors())
    assert again.tdc_readings == len(tdc)
    for name, array in played(thermal(), residuals, tdc)[0].to_tensors().items():
        assert_array_equal(again.to_tensors()[name], array)


def test_temperatures_that_say_nothing_change_nothing(rng) -> None:
    """Absent, zero, saturated and stuck TDC: predictions are equal to the bit to those without, and files hold no more."""
    residuals, tdc = readings_with_tdc(rng)
    plain, expected = played(drifting(), residuals, None)
    nothing = {"none": None, **{str(value): np.full_like(tdc, value) for value in (np.nan, 0.0, 4095.0, -9784.0)}}

    def check(_: str, rows: np.ndarray | None) -> None:
        tracker, offsets = played(thermal(), residuals, rows)
        assert_array_equal(offsets, expected)
        assert tracker.to_tensors().keys() == plain.to_tensors().keys()
        assert tracker.tdc_readings == 0

    every_case(nothing.items(), check)
    stuck = played(thermal(), residuals, np.full_like(tdc, 2345.0))
    assert_allclose(stuck[1], expected, atol=1e-9)


def test_a_jump_of_the_temperature_and_a_missing_finger_are_left_out(rng) -> None:
    residuals, tdc = readings_with_tdc(rng)
    jumped = tdc + np.where(np.arange(len(tdc)) < 20, 0.0, 700.0)[:, None]  # such as after a power cycle
    tracker, offsets = played(thermal(), residuals, jumped)
    assert tracker.tdc_jumps == 2
    last, night = START + (len(tdc) - 1) * S, 12 * 3600 * S
    for change, jumps in ((-750.0, 0), (850.0, 2)):  # after a night, a hand may be 10 K colder, 750 counts
        found, _ = played(thermal(), residuals, tdc)
        found.add_touch(last + night, REST + residuals[-1], REST, tdc=tdc[-1] + change)
        assert found.tdc_jumps == jumps
    smooth = tdc - np.where(np.arange(len(tdc)) < 20, 0.0, 1.0)[:, None] * (tdc[20] - tdc[19])
    assert_allclose(offsets, played(thermal(), residuals, smooth)[1], atol=1e-6)
    lone = np.column_stack([tdc[:, 0], np.full(len(tdc), np.nan)])
    offsets, both = (np.array(played(thermal(), residuals, rows)[1]) for rows in (lone, tdc))
    assert_array_equal(offsets[:, 2:26], both[:, 2:26])
    assert_array_equal(offsets[:, 26:], np.array(played(drifting(), residuals, None)[1])[:, 26:])


def test_taxels_that_were_not_read_leave_the_others_as_if_they_did_not_exist() -> None:
    """Against the dense Gaussian of the values that were read, with a basis that mixes the taxels of a finger."""
    rng = np.random.default_rng(4)
    own = BIOTAC.modality_columns["E_TH"]
    basis = 20.0 * np.eye(SIZE)
    basis[np.ix_(own, own)] = np.linalg.cholesky(300.0 * np.ones((24, 24)) + 200.0 * np.eye(24))
    slow = np.where(np.arange(SIZE) == own[0], 30.0, np.linspace(0.1, 2.0, SIZE))  # most of it is common to the taxels
    parameters = replace(drifting(), basis=basis, slow=slow, alarm=np.full((2, 2), 1e6))
    residual, unread = rng.normal(0.0, 60.0, SIZE) + 40.0, np.isin(np.arange(SIZE), own[[5, 11]])
    tracker = SensorTracker(parameters)
    touch(tracker, 0.0, np.where(unread, np.nan, residual))
    level, read = tracker.level(START), ~unread
    state = parameters.slow + parameters.fast + parameters.object[0]
    covariance = basis * state @ basis.T
    seen = covariance + basis @ basis.T
    expected = covariance[:, read] @ np.linalg.solve(seen[np.ix_(read, read)], residual[read])
    assert_allclose(level.offset, expected, atol=1e-9)
    spoiled = SensorTracker(parameters)
    touch(spoiled, 0.0, np.where(unread, 4095.0 - REST, residual))
    assert np.abs(spoiled.level(START).offset - expected)[read].max() > 5.0
    tared = SensorTracker(parameters)
    tared.add_tare(START, np.where(unread, np.nan, residual))
    assert np.isfinite(tared.level(START).offset).all()
