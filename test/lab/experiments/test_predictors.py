# SPDX-License-Identifier: Apache-2.0
"""Predictors: what touches add, and that the papers' recipes are those of `config/train`."""

import dataclasses

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose

from foretouch.errors import ConfigError, DatasetError
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import MODALITIES
from foretouch_lab.experiments.shared.predictors import PREDICTORS, RECIPES, find_predictor, with_offset_correction
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.baselines import training_mean
from foretouch_lab.learning.training.run_config import load_run_config
from foretouch_lab.learning.training.supervised import TrainConfig


@pytest.fixture(scope="module")
def samples():
    return make_samples(objects=4, each=12)


def test_offset_correction_by_hand_asks_the_baseline_once_for_each_sample(samples) -> None:
    train, held = samples[:36], samples[36:]
    labels = labels_of(train)
    fitted = with_offset_correction(training_mean)(train, labels, 0)
    mean = labels.mean(axis=0)
    assert_allclose(fitted.predict(held), np.tile(mean, (12, 1)))
    residuals = labels_of(held[:3]) - mean
    assert_allclose(fitted.predict_after(held[:3], held[3:]), np.tile(mean + residuals.sum(axis=0) / (3 + 2), (9, 1)))
    assert_allclose(fitted.predict_after([], held), fitted.predict(held))
    asked = []

    def counting(train, labels, test, seed):
        asked.extend(sample.id for sample in test)
        return training_mean(train, labels, test, seed)

    fitted = with_offset_correction(counting)(samples[:36], labels_of(samples[:36]), 0)
    for _ in range(2):
        fitted.predict(samples[36:])
        fitted.predict_after(samples[36:38], samples[38:])
    assert sorted(asked) == sorted(sample.id for sample in samples[36:])


def test_every_predictor_repeats_and_sees_no_test_label(samples) -> None:
    held = samples[36:38]
    blind = [dataclasses.replace(sample, touch=None) for sample in held]

    def check(name: str) -> None:
        train = samples[: 10 if name == "p1_pointnet" else 36]
        first, again = (find_predictor(name, 0.01)(train, labels_of(train), 3).predict(part) for part in (held, blind))
        assert first.shape == (2, 50)
        assert np.isfinite(first).all()
        assert np.array_equal(first, again)

    every_case([name for name in PREDICTORS if name != "p2_pointnet"], check)  # ten seconds, as p1's


def test_recipes_hold_the_settings_of_the_papers_and_of_the_released_network() -> None:
    """The values behind the committed results; they are written in `config` alone."""
    loaded = {name: load_run_config(recipe) for name, recipe in RECIPES.items()}
    papers = {"weight_decay": 0.0, "schedule": "constant", "loss": "rmse", "target_scaling": "ranges"}
    ranges = {"pdc_th": [0, 3100], "pdc_mf": [0, 2000], "e_th": [0, 3500], "e_mf": [0, 3800]}
    assert loaded["p1_pointnet"].train == TrainConfig.from_mapping(
        {"epochs": 50, "batch_size": 5, "optimiser": "sgd", "learning_rate": 0.01, **papers}
    )
    assert loaded["p1_pointnet"].model.replace(outputs=MODALITIES) == ModelConfig.from_mapping(
        {"n_points": 500, "use_grasp": False, "head_widths": [512, 256], "head_norm": True, "ranges": ranges}
    )
    assert loaded["p2_pointnet"].train == TrainConfig.from_mapping(
        {"epochs": 50, "batch_size": 32, "optimiser": "adam", "learning_rate": 0.01, **papers}
    )
    assert loaded["p2_pointnet"].model.replace(outputs=MODALITIES) == ModelConfig(channels="xyz+normals")
    assert loaded["touchnet_v1"].train == TrainConfig(epochs=120, turn_deg=20.0, points=256)
    assert loaded["touchnet_v1"].model == ModelConfig(
        tnet=False, trunk_widths=(32, 64, 128), head_widths=(128,), head_dropout=0.3, metric_inputs=True
    )
    assert [len(one.model.outputs) for one in loaded.values()] == [1, 1, 4]


def test_unknown_ones_are_told(samples) -> None:
    with pytest.raises(ConfigError, match="predictors: 'oracle' is not one of training_mean"):
        find_predictor("oracle")
    with pytest.raises(DatasetError, match="touch: is not labelled"):
        labels_of([dataclasses.replace(samples[0], touch=None)])
