# SPDX-License-Identifier: Apache-2.0
"""The level of each request: by the profile, less under load, and back with hysteresis, on a clock of the test."""

from itertools import pairwise

import pytest

from foretouch.tradeoff.budget.chooser import LatencyBudget
from foretouch.tradeoff.budget.levels import Level
from foretouch.tradeoff.budget.profile import Profile

LEVELS = [Level("model", 0.34, None), Level("half", 0.3, None), Level("mean", 0.0, None)]
TIMES = {
    "model": {1: 0.003, 10: 0.008, 100: 0.04},
    "half": {1: 0.002, 10: 0.004, 100: 0.009},
    "mean": {1: 0.0002, 10: 0.0003, 100: 0.001},
}


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def make(clock):
    return lambda ms, around=None: LatencyBudget(ms / 1e3, LEVELS, Profile(TIMES, "idle", "test"), around, clock)


def answer(budget, clock, count=1, slow=1.0, waited=0.0):
    """One request that takes `slow` times its profile; returns the level's name and whether it was late."""
    clock.now += 0.03
    run = budget.begin(count, clock.now - waited)
    clock.now += slow * TIMES[run.level.name].get(count, 0.005)
    return run.level.name, budget.end(run)


@pytest.mark.parametrize(
    ("ms", "count", "name"),
    [(5, 1, "model"), (5, 10, "half"), (5, 100, "mean"), (20, 100, "half"), (50, 100, "model"), (0.1, 1, "mean")],
)
def test_the_most_skilful_level_that_meets_the_budget_is_chosen(make, clock, ms, count, name):
    assert answer(make(ms), clock, count)[0] == name


def test_times_between_and_beyond_the_measured_numbers_are_linear(make):
    budget = make(10)
    assert budget.expected_s(LEVELS[0], 55) == pytest.approx(0.024)
    assert budget.expected_s(LEVELS[0], 1000) == pytest.approx(0.04 + 900 * 0.032 / 90)


def test_what_surrounds_the_prediction_counts(make, clock):
    assert answer(make(5, {1: 0.0018, 10: 0.002}), clock)[0] == "half"


def test_waiting_counts(make, clock):
    budget = make(10)
    assert answer(budget, clock)[0] == "model"
    assert answer(budget, clock, waited=0.0075)[0] == "half"
    assert answer(budget, clock)[0] == "model"  # it was that request alone
    assert answer(budget, clock, waited=0.02) == ("mean", True)


def test_a_queue_steps_down_until_it_is_gone(make, clock):
    budget = make(10)
    for _ in range(20):
        answer(budget, clock)
    names = [answer(budget, clock, waited=0.0075)[0] for _ in range(10)]
    assert names == ["half"] * 10
    assert budget.notes()["budget.overloaded"] == "true"
    names = [answer(budget, clock)[0] for _ in range(60)]
    assert names[0] == "half"
    assert names[-1] == "model"


def test_what_every_request_waits_is_no_overload(make, clock):
    budget = make(10)
    for _ in range(10):
        answer(budget, clock, count=10, waited=0.005)
    for _ in range(100):
        answer(budget, clock)
    for _ in range(50):  # the messages of ten grasps take 5 ms to arrive
        assert answer(budget, clock, count=10, waited=0.005)[0] == "half"
        assert answer(budget, clock)[0] == "model"
    assert budget.notes()["budget.overloaded"] == "false"
    assert answer(budget, clock, count=10, waited=0.0096)[0] == "mean"
    assert budget.notes()["budget.overloaded"] == "true"


def test_a_budget_that_nothing_meets_is_told(make, clock):
    budget = make(0.1)
    assert budget.affordable(1) is None
    run = budget.begin(1, clock.now)
    assert not run.affordable
    clock.now += 0.0002
    assert budget.end(run)  # late
    assert budget.notes()["budget.unaffordable"] == "1"


def test_overload_steps_down_within_three_answers_and_back_up_after_a_second(make, clock):
    budget = make(5)
    for _ in range(200):
        assert answer(budget, clock) == ("model", False)
    names = [answer(budget, clock, slow=3.0)[0] for _ in range(10)]
    assert names.count("model") <= 3
    assert names[-1] != "model"
    assert budget.notes()["budget.overloaded"] == "true"
    eased, names = clock.now, []
    while clock.now < eased + 15.0:
        names.append(answer(budget, clock)[0])
    changes = sum(a != b for a, b in pairwise(names))
    assert names[:20] == ["half"] * 20 or "mean" in names[:20]  # not at once
    assert names[-1] == "model"
    assert changes <= 2  # and not back and forth


def test_a_load_at_the_edge_does_not_make_it_swing(make, clock):
    budget = make(5)
    names = [answer(budget, clock, slow=1.0 + 0.9 * (k % 3 == 0))[0] for k in range(600)]
    changes = sum(a != b for a, b in pairwise(names))
    assert changes <= 3


def test_many_grasps_that_need_a_cheaper_level_leave_few_grasps_the_model(make, clock):
    budget, names = make(11), []
    for _ in range(100):
        assert answer(budget, clock, slow=1.4)[0] == "model"
        names.append(answer(budget, clock, count=100, slow=1.4)[0])  # half needs 12.6 ms
    assert names[0] == "half"
    assert names[2:] == ["mean"] * 98


def test_a_delay_that_no_level_avoids_costs_no_skill(make, clock):
    budget = make(10)
    for k in range(300):
        clock.now += 0.03
        run = budget.begin(1, clock.now)
        assert run.level.name == "model"
        clock.now += TIMES["model"][1] + 0.05 * (k % 10 == 9)  # one in ten is late by far
        assert budget.end(run) == (k % 10 == 9)


def test_one_delay_that_a_cheaper_level_would_avoid_costs_no_skill(make, clock):
    budget = make(5)
    for k in range(300):
        assert answer(budget, clock, slow=2.0 if k % 60 == 20 else 1.0)[0] == "model"


def test_every_late_answer_is_told(make, clock):
    budget = make(5)
    for k in range(300):
        slow = 10.0 if k % 7 == 0 else 1.0
        clock.now += 0.03
        run = budget.begin(1, clock.now)
        clock.now += slow * TIMES[run.level.name][1]
        took = clock.now - run.arrived
        assert budget.end(run) == (took > 0.005)
    notes = budget.notes()
    assert int(notes["budget.answered"]) == 300
    assert int(notes["budget.late"]) > 0
