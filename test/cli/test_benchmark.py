# SPDX-License-Identifier: Apache-2.0
"""`foretouch benchmark touch`: a row is one command, and finished rows stay."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from experiment_samples import make_samples

import foretouch as ft
from foretouch_lab.experiments.framework.manifest import read_results


@pytest.fixture
def words(tmp_path: Path) -> list[object]:
    """The command on eight made-up objects, with two baselines and one split."""
    ft.write(tmp_path / "session", make_samples(8, 6))
    settings = ["baselines=[training_mean,clock]", "splits=[object]", "bootstrap.draws=200"]
    places = ["--data", tmp_path / "session", "-o", tmp_path / "out", "--workers", "1"]
    return ["benchmark", "touch", *settings, *places]


@pytest.mark.slow
def test_a_command_adds_the_row_of_an_own_predictor_and_keeps_the_others(call, words, tmp_path) -> None:
    first = call(*words, "--model", "own_predictors:Memory")
    assert first.status == 0, first.err
    assert "24 cells (0 reused)" in first.out
    again = call(*words, "--model", "own_predictors:Constant", "--resume")
    assert again.status == 0, again.err
    assert "32 cells (24 reused)" in again.out
    rows = read_results(tmp_path / "out" / "results.csv")
    names = ["training_mean", "clock", "own_predictors:Memory", "own_predictors:Constant"]
    assert list(dict.fromkeys(row["predictor"] for row in rows)) == names
    assert {(row["seeds"], row["samples"], row["objects"]) for row in rows} == {(0, 48, 8)}
    assert all(row["cpu_s"] > 0.0 and len(str(row["data"])) == 16 for row in rows)
    page = (tmp_path / "out" / "summary.md").read_text(encoding="utf-8")
    assert (
        f"`foretouch benchmark touch --preset full --data {tmp_path / 'session'} 'models=" in page
    )  # it can be repeated
    assert "own_predictors:Constant, given as it is" in page
    assert (tmp_path / "out" / "leaderboard.png").stat().st_size > 10_000
    assert "32 cells (32 reused)" in call(*words, "--resume").out  # without --model, all rows stay
    assert read_results(tmp_path / "out" / "results.csv") == rows


def test_a_changed_predictor_is_fitted_again_and_finished_baselines_stay(call, words, tmp_path, monkeypatch) -> None:
    module = tmp_path / "changed_mine.py"
    monkeypatch.syspath_prepend(tmp_path)
    errors = []
    for level in ("0.0", "2500.0"):
        module.write_text(
            "import numpy as np\n\n\nclass Level:\n    def estimate(self, cloud, grasps, table=None):\n"
            f"        return np.full((len(grasps), 50), {level})\n",
            encoding="utf-8",
        )
        sys.modules.pop("changed_mine", None)
        answer = call(*words, "--preset", "smoke", "--model", "changed_mine:Level", "--resume")
        assert answer.status == 0, answer.err
        rows = read_results(tmp_path / "out" / "results.csv")
        errors.append([row["rmse"] for row in rows if row["predictor"] == "changed_mine:Level"])
    assert "24 cells (16 reused)" in answer.out
    assert "smoke: a quick trial" in answer.out
    assert all(new < old for old, new in zip(*errors, strict=True) if old is not None)


def test_first_touches_of_grasps_without_a_time_are_refused_before_anything_runs(call, words, tmp_path) -> None:
    ft.write(tmp_path / "timeless", [replace(sample, stamp_ns=0) for sample in make_samples(4, 6)])
    places = ["--data", tmp_path / "timeless", "-o", tmp_path / "none", "--workers", "1"]
    answer = call("benchmark", "touch", "baselines=[training_mean]", "models=[]", *places)
    answer.check_refused("splits: touches: needs the time of every grasp, and timeless holds grasps without one")
    answer.check_refused("leave it out: 'splits=[random,time,object]'")
    assert not (tmp_path / "none" / "results.csv").exists()


@pytest.mark.slow
def test_mistakes_are_one_line(call, words) -> None:
    call("benchmark", "tuoch", *words[2:]).check_refused("'tuoch' is not one of touch; did you mean touch?")
    call(*words, "--model", "clock").check_refused("models: clock is a baseline, which is scored anyway")
    answer = call(*words, "--model", "no_such_module:Mine")
    assert answer.status == 1
    assert "no_such_module" in answer.err
    assert "Traceback" not in answer.err
