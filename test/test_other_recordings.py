# SPDX-License-Identifier: Apache-2.0
"""Scores of what is learnt without a camera: against scikit-learn, and with what a series makes predictable."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.other_recordings import (
    EXPERIMENT,
    OtherSettings,
    Records,
    contact_readings,
    folds_of,
    hold_chance,
    level,
    next_reading,
)
from benchmarks.other_recordings.results import _pairs, auc, calibration_error, slip_first, tabulate
from foretouch.dataset.record import HOLD, REST, SampleRecord, TouchSeries
from foretouch.tactile import BIOTAC, biotac_touch
from foretouch.types import GraspSample
from foretouch_lab.experiments import find_experiment
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

RNG = np.random.default_rng(0)


def record(number: int, counts: np.ndarray, outcome: str = "unknown") -> SampleRecord:
    stamps = 10_000_000 * np.arange(len(counts)) + number * 60_000_000_000
    phases = np.where(np.arange(len(counts)) < 5, REST, HOLD).astype(np.uint8)
    touch = biotac_touch(np.median(counts[5:], axis=0))
    name = f"object_{number % 4}"
    sample = GraspSample(
        id=f"{name}/{number}", object=name, touch=touch, tare=biotac_touch(counts[0]), stamp_ns=int(stamps[0])
    )
    return SampleRecord(sample=sample, series=TouchSeries(stamps, counts.astype(np.float32), phases), outcome=outcome)  # type: ignore[arg-type]


def walk(slope: float, noise: float) -> np.ndarray:
    return 2000.0 + slope * np.arange(60)[:, None] + RNG.normal(0.0, noise, (60, BIOTAC.size))


def test_area_and_calibration_agree_with_scikit_learn_and_by_hand() -> None:
    from sklearn.metrics import roc_auc_score

    held = RNG.random(500) < 0.4
    chance = np.round(np.clip(held * 0.2 + RNG.random(500) * 0.8, 0.0, 1.0), 2)  # with ties
    assert_allclose(auc(chance, held), roc_auc_score(held, chance), rtol=1e-12)
    assert np.isnan(auc(chance, np.ones(500, bool)))
    # Two bins: .1, .1 with one of two held, .9 held: |.2 - 1| / 3 + |.9 - 1| / 3
    assert_allclose(calibration_error(np.array([0.1, 0.1, 0.9]), np.array([True, False, True])), 0.3, rtol=1e-12)


def test_folds_keep_objects_together() -> None:
    objects = np.array(list("aabbccdd"))
    folds = folds_of(objects, 3, 0)
    assert all(len(set(folds[objects == name])) == 1 for name in "abcd")
    assert set(folds) == {0, 1, 2}


def test_a_line_is_learnt_where_readings_are_lines_and_the_last_reading_where_they_are_not() -> None:
    lines = Records([record(k, walk(5.0, 0.01)) for k in range(8)], "")
    sums = {(row["method"], row["modality"]): row["squares"] for row in next_reading(lines, "object_1")}
    assert sums["line", "E_TH"] < 0.01 * sums["last", "E_TH"]
    assert sums["autoregression", "E_TH"] < 0.01 * sums["last", "E_TH"]
    steps = Records(
        [record(k, np.cumsum(RNG.normal(0.0, 5.0, (60, BIOTAC.size)), axis=0) + 2000.0) for k in range(8)], ""
    )
    sums = {(row["method"], row["modality"]): row["squares"] for row in next_reading(steps, "object_1")}
    assert sums["line", "E_TH"] > 1.5 * sums["last", "E_TH"]  # twice the variance
    assert abs(sums["autoregression", "E_TH"] / sums["last", "E_TH"] - 1.0) < 0.05


def test_repeated_readings_count_once() -> None:
    counts = np.repeat(walk(1.0, 1.0)[:20], 3, axis=0)
    values, rest = contact_readings(record(0, counts))
    assert len(values) == 19  # of 20, less those before contact
    assert_array_equal(rest, counts[0])


def test_the_level_of_a_grasp_follows_its_own_tare_where_sensors_drift() -> None:
    drift = np.cumsum(RNG.normal(0.0, 30.0, (20, BIOTAC.size)), axis=0)
    grasps = [
        record(k, np.where(np.arange(60)[:, None] < 5, 2000.0, 2100.0) + drift[k] + RNG.normal(0, 1, (60, BIOTAC.size)))
        for k in range(20)
    ]
    sums = {(row["method"], row["modality"]): row["squares"] for row in level(Records(grasps, ""), "object_2")}
    assert sums["tare + mean change", "E_MF"] < 0.05 * sums["last grasp", "E_MF"] < sums["mean of all", "E_MF"]


def test_what_holds_is_learnt_from_other_objects_and_tabulated_with_an_interval() -> None:
    grasps = [
        record(k, walk(0.0, 1.0) + 40.0 * (k % 3 == 0), "success" if k % 3 == 0 else "failure") for k in range(40)
    ]
    data, held = Records(grasps, ""), np.arange(40) % 3 == 0
    chance = hold_chance("electrode mean", OtherSettings(), data, np.arange(40) < 20, held)
    assert chance is not None
    assert hold_chance("patterns", OtherSettings(), data, np.arange(40) < 20, held) is None  # two fingers
    assert auc(chance[20:], held[20:]) == 1.0
    sessions = data.sessions.tolist()
    cells = {
        "what": "hold",
        "left_out": "objects",
        "objects": data.objects.tolist(),
        "held": held.tolist(),
        "sessions": sessions,
    }
    rows = [
        {**cells, "method": "a", "chance": chance.tolist()},
        {**cells, "method": "b", "chance": RNG.random(40).tolist()},
    ]
    good, blind = tabulate(rows, BootstrapConfig(draws=500))
    assert (good["score"], good["score_low"], good["grasps"], good["objects"]) == (1.0, 1.0, 40, 4)
    assert blind["score_low"] < blind["score"] < blind["score_high"]
    wins, pairs = _pairs(chance, held, data.objects)
    drawn = np.concatenate([np.flatnonzero(data.objects == f"object_{k}") for k in (0, 0, 1, 3)])
    weights = np.array([2.0, 1.0, 0.0, 1.0])
    assert_allclose(weights @ wins @ weights / (weights @ pairs @ weights), auc(chance[drawn], held[drawn]))


def test_what_drifts_in_a_session_does_not_win_where_the_slip_came_first() -> None:
    """By hand: of a session of slip, held, held, slip, two pairs have the slip first; of held, slip none has."""
    held, sessions = np.array([False, True, True, False, True, False]), np.array([0, 0, 0, 0, 1, 1])
    won, pairs = slip_first(np.array([0.5, 0.5, 0.9, 0.1, 0.9, 0.1]), held, sessions)
    assert (won.tolist(), pairs.tolist()) == ([1.5, 0.0], [2.0, 0.0])
    grasps = [record(k, walk(0.0, 1.0), "success" if k % 8 < 4 or k > 28 else "failure") for k in range(40)]
    data, held = Records(grasps, ""), np.array([one.outcome == "success" for one in grasps])
    assert data.places.tolist() == [k // 4 for k in range(40)]  # four objects in turn, of one file
    chance = hold_chance("place in session", OtherSettings(), data, np.ones(40, bool), held)
    assert chance is not None
    won, pairs = slip_first(chance if chance[0] > chance[-1] else 1.0 - chance, held, data.sessions)
    assert pairs.sum() > 0
    assert won.sum() == 0.0


def test_the_experiment_is_found_by_its_name() -> None:
    assert find_experiment("benchmarks.other_recordings") is EXPERIMENT
