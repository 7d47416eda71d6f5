# SPDX-License-Identifier: Apache-2.0
"""Predictors: the same again, without a look at what they are tested on."""

import dataclasses

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_samples

from foretouch_lab.experiments.shared.predictors import PREDICTORS
from foretouch_lab.learning.data import labels_of


@pytest.fixture(scope="module")
def samples():
    return make_samples(objects=4, each=12)


def test_every_predictor_repeats_and_sees_no_test_label(samples) -> None:
    held = samples[36:38]
    blind = [dataclasses.replace(sample, touch=None) for sample in held]

    def check(name: str) -> None:
        train = samples[:36]
        first, again = (PREDICTORS[name](0.01)(train, labels_of(train), part, 3) for part in (held, blind))
        assert first.shape == (2, 50)
        assert np.isfinite(first).all()
        assert np.array_equal(first, again)

    every_case(list(PREDICTORS), check)
