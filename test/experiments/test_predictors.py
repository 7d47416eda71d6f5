# SPDX-License-Identifier: Apache-2.0
"""Predictors: what touches add, and that the papers' recipes are those of `config/train`."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from experiment_samples import make_samples
from numpy.testing import assert_allclose

from foretouch.config import load_yaml
from foretouch.errors import ConfigError, DatasetError
from foretouch.experiments.shared.predictors import PREDICTORS, RECIPES, find_predictor, with_offset_correction
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.baselines import training_mean

TRAIN = Path(__file__).parents[2] / "config/train"


@pytest.fixture(scope="module")
def samples():
    return make_samples(objects=4, each=12)


def test_with_offset_correction_by_hand(samples) -> None:
    train, held = samples[:36], samples[36:]
    labels = labels_of(train)
    fitted = with_offset_correction(training_mean)(train, labels, 0)
    mean = labels.mean(axis=0)
    assert_allclose(fitted.predict(held), np.tile(mean, (12, 1)))
    residuals = labels_of(held[:3]) - mean
    assert_allclose(fitted.predict_after(held[:3], held[3:]), np.tile(mean + residuals.sum(axis=0) / (3 + 2), (9, 1)))
    assert_allclose(fitted.predict_after([], held), fitted.predict(held))


def test_a_baseline_is_asked_once_for_each_sample(samples) -> None:
    asked = []

    def counting(train, labels, test, seed):
        asked.extend(sample.id for sample in test)
        return training_mean(train, labels, test, seed)

    fitted = with_offset_correction(counting)(samples[:36], labels_of(samples[:36]), 0)
    for _ in range(2):
        fitted.predict(samples[36:])
        fitted.predict_after(samples[36:38], samples[38:])
    assert sorted(asked) == sorted(sample.id for sample in samples[36:])


@pytest.mark.parametrize("name", [name for name in PREDICTORS if name != "p2_pointnet"])  # ten seconds, as p1's
def test_every_predictor_repeats_and_sees_no_test_label(samples, name: str) -> None:
    train, held = samples[:36], samples[36:]
    labels = labels_of(train)
    effort = 0.01
    if name == "p1_pointnet":
        train, labels = train[:10], labels[:10]  # two batches
    blind = [dataclasses.replace(sample, touch=None) for sample in held[:2]]
    first = find_predictor(name, effort)(train, labels, 3).predict(held[:2])
    again = find_predictor(name, effort)(train, labels, 3).predict(blind)
    assert first.shape == (2, 50)
    assert np.isfinite(first).all()
    assert np.array_equal(first, again)


@pytest.mark.parametrize(
    ("name", "file"), [("p1_pointnet", "p1"), ("p2_pointnet", "p2"), ("touchnet_v1", "touchnet-v1")]
)
def test_recipes_are_those_of_the_configurations(name: str, file: str) -> None:
    from foretouch.learning.training.supervised import TrainConfig
    from foretouch.models.network.config import ModelConfig

    written, recipe = load_yaml(TRAIN / f"{file}.yaml"), RECIPES[name]
    one = ("PDC_TH",) if recipe["one_a_modality"] else ModelConfig().outputs
    assert ModelConfig.from_mapping(written["model"]).replace(outputs=one) == ModelConfig.from_mapping(
        recipe["model"]
    ).replace(outputs=one)
    assert TrainConfig.from_mapping(written["train"]) == TrainConfig.from_mapping(recipe["train"])


def test_unknown_ones_are_told(samples) -> None:
    with pytest.raises(ConfigError, match="predictors: 'oracle' is none of training_mean"):
        find_predictor("oracle")
    with pytest.raises(DatasetError, match="touch: is not labelled"):
        labels_of([dataclasses.replace(samples[0], touch=None)])
