# SPDX-License-Identifier: Apache-2.0
"""A dead electrode from a dataset to predictions, scores and the readings of a hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_builders import run_config, write_store

from foretouch.models.registry import load_model
from foretouch.models.touch_model import History
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import with_dead_taxels
from foretouch.types import Sample, Touch
from foretouch_lab.learning.data import Dataset, load_dataset
from foretouch_lab.learning.evaluation.evaluate import evaluate_model
from foretouch_lab.learning.training.run import train_run

CONTACT = {"method": "contact", "contact": {"trees": 4}}
FIFTH, ELEVENTH = BIOTAC_SP.taxel_columns[0, [5, 11], 0]


def damaged(sample: Sample, column: int = FIFTH, value: float = 800.0) -> Sample:
    assert sample.touch is not None
    values = np.where(np.arange(50) == column, value, sample.touch.values)
    return replace(sample, touch=Touch(values, sample.touch.channels))


@pytest.fixture(scope="module")
def broken(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("broken")
    return load_dataset(write_store(folder / "set", (damaged(sample) for sample in data.samples)))


@pytest.fixture(scope="module")
def card(broken: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    said: list[dict] = []
    card = train_run(run_config(**CONTACT), broken, tmp_path_factory.mktemp("model") / "run", said.append)
    assert said[-1]["dead_taxels"] == {"TH": [5]}
    return card


def test_the_card_names_it_and_its_predictions_are_not_valid(broken: Dataset, card: Path) -> None:
    assert broken.sensor.dead == {"TH": [5]}
    assert (
        "Dead in the training data, so that their predictions are not valid: taxels TH 5."
        in json.loads(card.read_text())["limits"]
    )
    model = load_model(card)
    assert model.sensor.dead == {"TH": [5]}
    sample = broken.samples[0]
    (one,) = model.predict(sample.cloud, [sample.grasp])
    assert one.ok
    assert "out_of_range" not in one.flags  # by the mean of the neighbours, not by 800


@pytest.mark.slow
def test_it_is_left_out_of_scores_and_others_score_as_without_it(broken: Dataset, card: Path) -> None:
    scores = evaluate_model(card, broken, "random", training_scores=True)
    assert scores["not_scored"] == {"TH": [5]}
    other = replace(broken, samples=tuple(damaged(damaged(sample), ELEVENTH, 0.0) for sample in broken.samples))
    other = replace(
        other, sensor=with_dead_taxels(other.sensor, np.array([sample.touch.values for sample in other.samples]))
    )
    assert other.sensor.dead == {"TH": [5, 11]}
    result = evaluate_model(card, other, "random", training_scores=True)
    assert result["not_scored"] == {"TH": [5, 11]}
    for name in ("PDC_TH", "PDC_MF", "E_MF"):
        assert result["scores"]["model"][name]["rmse"] == scores["scores"]["model"][name]["rmse"]
    assert result["scores"]["model"]["E_TH"]["rmse"] != scores["scores"]["model"]["E_TH"]["rmse"]


def test_what_a_dead_electrode_reads_does_not_matter_to_a_hand(broken: Dataset, card: Path) -> None:
    model = load_model(card)
    asked = broken.samples[1]

    def after(column: int, value: float, tare: bool) -> np.ndarray:
        hand, sample = History(model), damaged(broken.samples[0], column, value)
        assert sample.touch is not None
        if tare:
            hand.tare(sample.touch, stamp_ns=10**9)
        else:
            hand.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=10**9, same_object=True)
        (one,) = model.predict(asked.cloud, [asked.grasp], history=hand.at(2 * 10**9, same_object=not tare))
        assert one.ok
        return one.value.values

    for tare in (False, True):
        np.testing.assert_array_equal(
            after(FIFTH, 800.0, tare), after(FIFTH, 4095.0, tare)
        )  # dead in the training data
        np.testing.assert_array_equal(after(ELEVENTH, np.nan, tare), after(ELEVENTH, 0.0, tare))  # dead on the hand
        whole, missing = after(FIFTH, 800.0, tare), after(ELEVENTH, np.nan, tare)
        others = np.setdiff1d(np.arange(50), [FIFTH, ELEVENTH])
        assert np.abs(whole - missing)[others].max() < 30.0
