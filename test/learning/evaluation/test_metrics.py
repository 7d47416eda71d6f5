# SPDX-License-Identifier: Apache-2.0
"""Metrics by hand and against scikit-learn."""

import numpy as np
import pytest
from sklearn.metrics import r2_score, root_mean_squared_error

from foretouch.errors import DatasetError
from foretouch.learning.evaluation.metrics import score
from foretouch.tactile import MODALITIES, columns


@pytest.fixture
def actual(rng) -> np.ndarray:
    return rng.normal(2500.0, 200.0, (30, 50))


def test_by_hand() -> None:
    actual, predicted, reference = np.full((2, 50), 3000.0), np.full((2, 50), 3000.0), np.full((2, 50), 3000.0)
    actual[:, 0], predicted[:, 0], reference[:, 0] = [2900, 3100], [2910, 3070], [3000, 3000]
    reference[:, 1:] += 1.0
    one = score(predicted, actual, reference)["PDC_TH"]
    assert one.rmse == pytest.approx(np.sqrt((100 + 900) / 2))
    assert one.nrmse == pytest.approx(np.sqrt(500) / 900)
    assert one.skill == pytest.approx(1 - 500 / 10000)


def test_agrees_with_scikit_learn(actual, rng) -> None:
    predicted = actual + rng.normal(0.0, 50.0, actual.shape)
    mean = np.tile(actual.mean(axis=0), (30, 1))
    scores = score(predicted, actual, mean)
    for name in MODALITIES:
        column = columns([name])
        assert scores[name].skill == pytest.approx(r2_score(actual[:, column], predicted[:, column]))
        pooled = root_mean_squared_error(actual[:, column].ravel(), predicted[:, column].ravel())
        assert scores[name].rmse == pytest.approx(pooled)


def test_bad_input_is_named(actual) -> None:
    with pytest.raises(DatasetError, match=r"predicted: shape \(30, 24\)"):
        score(actual[:, :24], actual, actual + 1)
    with pytest.raises(DatasetError, match="predicted: holds a value that is not finite"):
        score(np.full_like(actual, np.nan), actual, actual + 1)
    with pytest.raises(DatasetError, match="PDC_TH: the training mean is exact"):
        score(actual, actual, actual)
