# SPDX-License-Identifier: Apache-2.0
"""A made-up method, the mean of the labels, goes the way of every model: train, RUN, models, predict, evaluate.

It takes three pieces: an estimator with a function that loads it, its row in `KINDS`, and a learner under `@register`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from foretouch.cli.main import main
from foretouch.learning.training.learners import Learner, RunConfig, find_learner, load_run_config, register
from foretouch.learning.training.learners.learner import LEARNERS
from foretouch.learning.training.run import train_run
from foretouch.models import load_model
from foretouch.models.calibration import add_calibration, load_calibration
from foretouch.models.card import KINDS, ModelKind, card_text, new_card, write_text
from foretouch.models.files import packed, read_tensors, replace_files
from foretouch.models.touch_model import Estimate, TouchModel
from foretouch.tactile import P2_RANGES

FACTS = {"config": {}, "skill": {}, "baselines": {}, "calibration": None}


class MeanEstimator:
    """Predicts the same counts for every grasp."""

    ranges = P2_RANGES

    def __init__(self, mean: np.ndarray) -> None:
        self.mean = mean

    def estimate(self, cloud, grasps) -> Estimate:
        return Estimate(np.tile(self.mean, (len(grasps), 1)), np.ones(len(grasps), np.bool_))


def load_mean(path: Path, card: dict) -> TouchModel:
    tensors = read_tensors(path.with_name(card["weights"]), card["sha256"], path.name)
    return TouchModel(MeanEstimator(tensors["mean"]), card, load_calibration(path, card)[0])


class MeanLearner(Learner[RunConfig]):
    """The mean of the training labels."""

    def fit(self, chosen=None, run=None) -> None:
        self._mean = self.labels.mean(axis=0) if chosen is None else self.labels[chosen].mean(axis=0)

    def predict(self, index):
        return np.tile(self._mean, (len(index), 1))

    def save(self, folder, name, facts, calibration=None) -> Path:
        path = folder / f"{name}.json"
        content, sha256 = packed({"mean": self._mean})
        card = new_card(name, "mean", weights=f"{name}.safetensors", sha256=sha256, **{**FACTS, **facts})
        replace_files({folder / card["weights"]: content})
        write_text(path, card_text(card))
        if calibration is not None:
            add_calibration(path, *calibration)
        return path


@pytest.fixture
def mean_method(monkeypatch) -> None:
    monkeypatch.setitem(LEARNERS, "mean", MeanLearner)
    monkeypatch.setitem(KINDS, "mean", ModelKind(f"{__name__}:load_mean", KINDS["contact"].fields))


@pytest.fixture
def call(capsys) -> Callable[..., list[dict]]:
    """Runs a command that succeeds, and returns its JSON lines."""

    def run(*words: object) -> list[dict]:
        assert main([*map(str, words), "--json"]) == 0, capsys.readouterr().err
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    return run


def test_a_made_up_method_goes_from_dataset_to_run_to_predictions(call, mean_method, store, data, tmp_path) -> None:
    run = tmp_path / "run"
    *_, result = call("train", "mean", f"data={store}", "calibrate=true", "split=random/random 0", "-o", run)
    assert result["card"] == str(run / "mean.json")
    (part,) = data.parts("random/random 0")
    expected = np.mean([data.samples[k].touch.vector() for k in data.index(part.train)], axis=0)
    sample = data.samples[0]
    (prediction,) = load_model(run).predict(sample.cloud, [sample.grasp])
    np.testing.assert_allclose(prediction.value.vector(), expected)
    assert (prediction.lower.vector() < expected).all()

    (listed,) = call("models", run)
    assert (listed["status"], listed["kind"], listed["calibration"]["objects"]) == ("ok", "mean", 4)
    first, *_ = call("predict", store, "--model", run)
    assert first["predictions"][0]["PDC_TH"]["value"] == pytest.approx(expected[0], abs=0.01)
    (scores,) = call("evaluate", run, store, "--split", "random/random 0")
    assert scores["E_TH"]["skill"] == pytest.approx(0.0, abs=1e-9)
    assert scores["baselines"]["training_mean"]["E_TH"]["rmse"] == pytest.approx(scores["E_TH"]["rmse"])


def test_a_release_of_a_made_up_method(mean_method, store, tmp_path) -> None:
    out = tmp_path / "out"
    assert main(["train", "mean", f"data={store}", "release=true", "name=lab-mean", "-o", str(out)]) == 0
    card = json.loads((out / "lab-mean.json").read_text())
    assert card["skill"]["object"]["PDC_TH"] == card["baselines"]["training_mean"]["object"]["PDC_TH"]
    assert set(card["calibration"]["regimes"]) == {"known", "new"}


def test_a_learner_is_found_once_it_is_registered(monkeypatch) -> None:
    monkeypatch.setitem(LEARNERS, "mean", MeanLearner)  # and away again, whatever is registered below
    learner = register("mean")(type("Other", (MeanLearner,), {}))
    assert find_learner("mean") is learner
    assert load_run_config("mean", ["data=x"]).method == "mean"


def test_every_method_loads_what_it_saved(data, tmp_path) -> None:
    config = load_run_config("contact", ["contact.trees=4"])
    card = train_run(config, data, tmp_path / "run", lambda _: None)
    assert find_learner("contact").load(card).sha256 == load_model(tmp_path / "run").sha256
