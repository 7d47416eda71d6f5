# SPDX-License-Identifier: Apache-2.0
"""The contact predictor of experiments gives the intervals of the touch model."""

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, with_tares
from experiment_samples import make_samples

from foretouch.errors import DatasetError
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.metrics import mean_over_objects
from foretouch.learning.training.contact import ContactPredictor
from foretouch.models.touch_model import ObjectResiduals, TouchModel


@pytest.fixture(scope="module")
def sides() -> tuple[list, list]:
    samples = with_tares(make_samples(5, 10), 30.0)
    return samples[:40], samples[40:]


@pytest.fixture(scope="module")
def fitted(sides) -> ContactPredictor:
    return ContactPredictor(sides[0], labels_of(sides[0]), FEW_TREES)


@pytest.mark.parametrize("tare", [False, True])
@pytest.mark.parametrize("touches", [0, 3])
def test_intervals_are_those_of_the_touch_model(fitted, sides, tare: bool, touches: int) -> None:
    model = TouchModel(fitted.estimator, {"name": "toy", "sha256": ""}, fitted.calibration[0])
    held = sides[1]
    counts, half = fitted.intervals_after(held[:touches], held[touches:], tare=tare)
    for sample, row, width in zip(held[touches:], counts, half, strict=True):
        # Each sample has its own tare, residuals have one: so readings are shifted to that one.
        residuals = ObjectResiduals(model, sample.tare if tare else None)
        for one in held[:touches]:
            shift = sample.tare.vector() - one.tare.vector() if tare else 0.0
            residuals.add(one.cloud, one.grasp, type(one.touch).from_vector(one.touch.vector() + shift))
        (prediction,) = model.predict(sample.cloud, [sample.grasp], residuals=residuals)
        np.testing.assert_allclose(prediction.value.vector(), row, atol=1e-6)
        np.testing.assert_allclose(prediction.upper.vector() - prediction.value.vector(), width, rtol=1e-9)


def test_a_tare_that_is_missing_is_named(fitted) -> None:
    with pytest.raises(DatasetError, match="tare: is missing"):
        fitted.intervals_after([], make_samples(1, 1), tare=True)


def test_mean_over_objects() -> None:
    """Equal numbers have an interval of no width; below six objects there is no interval."""
    same = mean_over_objects(np.full(8, 0.9))
    assert (same.value, same.low, same.high) == pytest.approx((0.9, 0.9, 0.9))
    spread = mean_over_objects(np.linspace(0.6, 1.0, 9))
    assert 0.6 < spread.low < 0.75 < spread.value < 0.85 < spread.high < 1.0
    assert mean_over_objects(np.array([0.5, 1.0])).low is None
