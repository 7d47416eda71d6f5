# SPDX-License-Identifier: Apache-2.0
"""Predictors: what touches add, and that the papers' recipes are those of `config/train`."""

import dataclasses

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose

from foretouch_lab.experiments.shared.predictors import PREDICTORS, find_predictor, with_offset_correction
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.baselines import training_mean


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
