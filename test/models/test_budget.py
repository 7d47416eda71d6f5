# SPDX-License-Identifier: Apache-2.0
"""Predictions within a time: levels of a model, the profile of a machine, and the level of each request."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from contact_model_builders import FEW_TREES
from every_case import every_case
from experiment_samples import make_samples

from foretouch.cli.main import main
from foretouch.models import budget as budgets
from foretouch.models import load_model
from foretouch.models.budget import LatencyBudget, Level, levels_of, profile_scene
from foretouch.models.contact.estimator import fewer_trees
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.training.contact import describe_samples, fit_contact


def test_cheaper_contact_models() -> None:
    samples = make_samples()
    rows = describe_samples(samples)
    objects = [sample.object for sample in samples]
    large, small = (fit_contact(rows, labels_of(samples), objects, FEW_TREES.replace(trees=trees)) for trees in (4, 2))
    np.testing.assert_array_equal(fewer_trees(large, 2).predict_rows(rows)[0], small.predict_rows(rows)[0])
    np.testing.assert_array_equal(fewer_trees(large, 9).predict_rows(rows)[0], large.predict_rows(rows)[0])
    for forest in fewer_trees(large, 2).forests.values():
        forest._check()
    changed = rows.copy()
    changed[:, -14:] += 1.0  # the second contact
    plain = replace(large, surroundings=False)
    np.testing.assert_array_equal(plain.predict_rows(rows)[0], plain.predict_rows(changed)[0])
    assert np.abs(large.predict_rows(rows)[0] - plain.predict_rows(rows)[0]).max() > 1e-3


def test_levels_of_the_default_model_descend_to_the_mean() -> None:
    model = load_model()
    levels = levels_of(model)
    skills = [level.skill for level in levels]
    assert levels[0].model is model
    assert [level.name for level in levels[1:]] == ["10 trees", "no surroundings", "mean of labels"]
    assert skills == sorted(skills, reverse=True)
    cloud, grasps = profile_scene(2)
    first = model.predict(cloud, grasps)[0]
    for level in levels[1:]:
        found = level.model.predict(cloud, grasps)[0]
        assert level.model.sha256 == model.sha256
        assert found.status == "ok"
        width = found.upper["PDC_TH"][0] - found.lower["PDC_TH"][0]
        assert width >= 0.999 * (first.upper["PDC_TH"][0] - first.lower["PDC_TH"][0])  # never narrower than the model's
    mean = levels[-1].model.predict(cloud, grasps)[0]
    assert mean.flags == ("unfamiliar",)
    np.testing.assert_allclose(mean.value.values, model.estimator.mean)
    other = levels_of(load_model("simulated"))[0]
    assert (other.name, other.skill) == ("simulated", None)


@pytest.fixture
def measured(monkeypatch):
    """Answers measurements at once: a level takes 2 ms for each of those after it."""

    def measure(levels):
        return {one.name: {1: 0.002 * (len(levels) - k), 100: 0.05} for k, one in enumerate(levels)}

    monkeypatch.setattr(budgets, "_measure", measure)


@pytest.mark.usefixtures("measured")
def test_predict_keeps_to_a_budget_and_names_the_level(capsys, tmp_path) -> None:
    cloud, grasps = profile_scene(1)
    np.savez(tmp_path / "can.npz", xyz=cloud.xyz)
    contacts = ",".join(f"{value:.6f}" for value in (*grasps[0].g1, *grasps[0].g2))
    words = ["predict", str(tmp_path / "can.npz"), f"--grasp={contacts}", "--plane=0,0,1,-1.27", "--json"]
    for budget, level in ((None, None), ("10000", "contact-v3"), ("3", "mean of labels"), ("0.5", "mean of labels")):
        assert main([*words, *([] if budget is None else ["--budget-ms", budget])]) == 0
        out, err = capsys.readouterr()
        record = json.loads(out)
        assert record.get("level") == level
        assert ("reduced" in record["predictions"][0]["flags"]) == (level == "mean of labels")
        assert ("nothing meets it for 1 grasps: mean of labels is used" in err) == (budget == "0.5")
    with pytest.raises(SystemExit):
        main([*words, "--budget-ms", "0"])
    assert "0 is not above 0" in capsys.readouterr().err


LEVELS = [Level("model", 0.34, None), Level("half", 0.3, None), Level("mean", 0.0, None)]
TIMES = {
    "model": {1: 0.003, 10: 0.008, 100: 0.04},
    "half": {1: 0.002, 10: 0.004, 100: 0.009},
    "mean": {1: 0.0002, 10: 0.0003, 100: 0.001},
}


class Requests:
    """A budget and its clock."""

    def __init__(self, budget_ms, around=None):
        self.now = 100.0
        self.budget = LatencyBudget(budget_ms / 1e3, LEVELS, TIMES, around or {1: 0.0}, lambda: self.now)

    def answer(self, count=1, slow=1.0, waited=0.0, delay=0.0):
        """One request that takes `slow` times its profile and a delay [s]; the name of its level, and whether it was late."""
        self.now += 0.03
        run = self.budget.begin(count, self.now - waited)
        self.now += slow * run.expected_s + delay
        late = self.budget.end(run)
        assert late == (self.now - run.arrived > self.budget.budget_s - 2e-4)
        return run.level.name, late


def test_the_most_skilful_level_that_meets_the_budget_is_chosen() -> None:
    def check(budget_ms, count, around, name) -> None:
        assert Requests(budget_ms, around).answer(count)[0] == name

    cases = [
        (5, 1, None, "model"), (5, 10, None, "half"), (5, 100, None, "mean"), (20, 100, None, "half"),
        (50, 100, None, "model"), (0.1, 1, None, "mean"), (23.9, 55, None, "half"), (24.1, 55, None, "model"),
        (359, 1000, None, "half"), (361, 1000, None, "model"), (4.7, 1, {1: 0.0018, 10: 0.002}, "half"),
    ]  # fmt: skip
    every_case({f"{ms} ms, {count} grasps": (ms, count, *rest) for ms, count, *rest in cases}, check)


def test_waiting_counts_and_a_queue_steps_down_until_it_is_gone() -> None:
    requests = Requests(10)
    assert requests.answer()[0] == "model"
    assert requests.answer(waited=0.0075)[0] == "half"
    assert requests.answer()[0] == "model"  # it was that request alone
    assert requests.answer(waited=0.02) == ("mean", True)
    assert requests.answer()[0] == "model"
    requests = Requests(10)  # what every request waits is not an overload
    for _ in range(50):  # the messages of ten grasps take 5 ms to arrive
        assert requests.answer(count=10, waited=0.005)[0] == "half"
        assert requests.answer()[0] == "model"
    assert requests.answer(count=10, waited=0.0096)[0] == "mean"
    assert Requests(5).budget.affordable(10).name == "half"
    requests = Requests(0.1)  # nothing meets it
    assert requests.budget.affordable(1) is None
    assert not requests.budget.begin(1, requests.now).affordable
    assert requests.answer() == ("mean", True)
    assert requests.budget.notes()["budget.unaffordable"] == "1"


def test_overload_steps_down_within_three_answers_and_back_up_after_three_seconds() -> None:
    requests = Requests(5)
    for _ in range(200):
        assert requests.answer() == ("model", False)
    names = [requests.answer(slow=3.0)[0] for _ in range(10)]
    assert names == ["model"] * 2 + ["mean"] * 8  # half would need 6 ms
    eased, names = requests.now, []
    while requests.now < eased + 6.0:
        names.append(requests.answer()[0])
    assert (names[0], names[-1]) == ("mean", "model")
    assert 80 < names.index("model") < 110
    assert sum(a != b for a, b in pairwise(names)) == 1
    requests = Requests(5)  # a load at the edge does not make it swing
    names = [requests.answer(slow=1.0 + 0.9 * (k % 3 == 0))[0] for k in range(600)]
    assert sum(a != b for a, b in pairwise(names)) <= 3
    requests, names = Requests(11), []  # many grasps that need a cheaper level leave few grasps the model
    for _ in range(100):
        assert requests.answer(slow=1.4)[0] == "model"
        names.append(requests.answer(count=100, slow=1.4)[0])  # half needs 12.6 ms
    assert names == ["half"] + ["mean"] * 99


def test_delays_that_no_level_avoids_and_single_ones_cost_no_skill() -> None:
    requests = Requests(10)
    assert all(requests.answer(delay=0.05 * (k % 10 == 9)) == ("model", k % 10 == 9) for k in range(300))
    requests = Requests(10)  # all are far too late: the sooner they are done, the better
    assert [requests.answer(delay=0.05)[0] for k in range(5)] == ["model"] + ["mean"] * 4
