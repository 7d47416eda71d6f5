# SPDX-License-Identifier: Apache-2.0
"""Whether a grasp holds, from its touch alone: what is learnt from other objects, and its scores."""

import numpy as np
from numpy.testing import assert_allclose

from benchmarks.other_recordings import OtherSettings, Records, folds_of, hold_chance
from benchmarks.other_recordings.results import calibration_error, slip_first, tabulate
from foretouch.tactile import BIOTAC, biotac_touch
from foretouch.types import Sample
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

RNG = np.random.default_rng(0)


def record(number: int, shift: float, outcome: str) -> Sample:
    touch, name = biotac_touch(2000.0 + shift + RNG.normal(0.0, 0.2, BIOTAC.size)), f"object_{number % 4}"
    return Sample(id=f"{name}/{number}", object=name, touch=touch, stamp_ns=number * 60_000_000_000, outcome=outcome)  # type: ignore[arg-type]


def test_calibration_by_hand() -> None:
    # Two bins: .1, .1 with one of two held, .9 held: |.2 - 1| / 3 + |.9 - 1| / 3
    assert_allclose(calibration_error(np.array([0.1, 0.1, 0.9]), np.array([True, False, True])), 0.3, rtol=1e-12)


def test_folds_keep_objects_together() -> None:
    objects = np.array(list("aabbccdd"))
    folds = folds_of(objects, 3, 0)
    assert all(len(set(folds[objects == name])) == 1 for name in "abcd")
    assert set(folds) == {0, 1, 2}


def test_what_holds_is_learnt_from_other_objects_and_tabulated_with_an_interval() -> None:
    grasps = [record(k, 40.0 * (k % 3 == 0), "success" if k % 3 == 0 else "failure") for k in range(40)]
    data, held = Records(grasps, ""), np.arange(40) % 3 == 0
    chance = hold_chance("electrode mean", OtherSettings(), data, np.arange(40) < 20, held)
    assert chance is not None
    assert hold_chance("patterns", OtherSettings(), data, np.arange(40) < 20, held) is None  # two fingers
    assert chance[20:][held[20:]].min() > chance[20:][~held[20:]].max()
    sessions = data.sessions.tolist()
    cells = {"left_out": "objects", "objects": data.objects.tolist(), "held": held.tolist(), "sessions": sessions}
    rows = [
        {**cells, "method": "a", "chance": chance.tolist()},
        {**cells, "method": "b", "chance": RNG.random(40).tolist()},
    ]
    good, blind = tabulate(rows, BootstrapConfig(draws=500))
    assert (good["score"], good["score_low"], good["grasps"], good["objects"]) == (1.0, 1.0, 40, 4)
    assert blind["score_low"] < blind["score"] < blind["score_high"]


def test_what_drifts_in_a_session_does_not_win_where_the_slip_came_first() -> None:
    """By hand: of a session of slip, held, held, slip, two pairs have the slip first; of held, slip none has."""
    held, sessions = np.array([False, True, True, False, True, False]), np.array([0, 0, 0, 0, 1, 1])
    won, pairs = slip_first(np.array([0.5, 0.5, 0.9, 0.1, 0.9, 0.1]), held, sessions)
    assert (won.tolist(), pairs.tolist()) == ([1.5, 0.0], [2.0, 0.0])
    grasps = [record(k, 0.0, "success" if k % 8 < 4 or k > 28 else "failure") for k in range(40)]
    data, held = Records(grasps, ""), np.array([grasp.outcome == "success" for grasp in grasps])
    assert data.places.tolist() == [k // 4 for k in range(40)]  # four objects in turn, of one file
    chance = hold_chance("place in session", OtherSettings(), data, np.ones(40, bool), held)
    assert chance is not None
    won, pairs = slip_first(chance if chance[0] > chance[-1] else 1.0 - chance, held, data.sessions)
    assert pairs.sum() > 0
    assert won.sum() == 0.0
