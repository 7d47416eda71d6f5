# SPDX-License-Identifier: Apache-2.0
"""Predictors: what touches add, and that the papers' recipes are those of `config/train`."""

import dataclasses

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose

from foretouch_lab.experiments.hold_out import offset_corrected
from foretouch_lab.experiments.shared.predictors import PREDICTORS
from foretouch_lab.learning.data import labels_of


@pytest.fixture(scope="module")
def samples():
    return make_samples(objects=4, each=12)


def test_offset_correction_by_hand(samples) -> None:
    labels = labels_of(samples[36:])
    mean = np.tile(labels_of(samples[:36]).mean(axis=0), (12, 1))
    found = offset_corrected(mean, labels, np.array([0, 1, 2]))
    assert_allclose(found, mean + (labels[:3] - mean[:3]).sum(axis=0) / (3 + 2))


def test_every_predictor_repeats_and_sees_no_test_label(samples) -> None:
    held = samples[36:38]
    blind = [dataclasses.replace(sample, touch=None) for sample in held]

    def check(name: str) -> None:
        train = samples[: 10 if name == "p1_pointnet" else 36]
        first, again = (PREDICTORS[name](0.01)(train, labels_of(train), part, 3) for part in (held, blind))
        assert first.shape == (2, 50)
        assert np.isfinite(first).all()
        assert np.array_equal(first, again)

    every_case([name for name in PREDICTORS if name != "p2_pointnet"], check)  # ten seconds, as p1's
