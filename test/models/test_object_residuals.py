# SPDX-License-Identifier: Apache-2.0
"""Residuals on one object: what is stored of the readings, and which readings are refused."""

from __future__ import annotations

import numpy as np
import pytest
from calibrated_models import REST, make_calibration
from contact_model_builders import labels_of, small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import CloudError, ModelError, TactileError
from foretouch.models.touch_model import ObjectResiduals, TouchModel
from foretouch.types import Cloud, Touch

CARD = {"name": "small", "sha256": "0" * 64}
SAMPLES = make_samples(2, 6)


@pytest.fixture
def model() -> TouchModel:
    return TouchModel(small_estimator(), CARD, make_calibration())


def add_all(residuals: ObjectResiduals, samples) -> None:
    for sample in samples:
        residuals.add(sample.cloud, sample.grasp, sample.touch)


def test_it_stores_means_of_predictions_and_readings(model) -> None:
    residuals = ObjectResiduals(model)
    assert residuals.count == 0
    assert_array_equal(residuals.means(), np.zeros((2, 50)))
    add_all(residuals, SAMPLES[:4])
    expected, read = residuals.means()
    assert residuals.count == 4
    assert_allclose(read, labels_of(SAMPLES[:4]).mean(axis=0))
    assert_allclose(expected, np.mean([model.expect(s.cloud, [s.grasp])[0] for s in SAMPLES[:4]], axis=0))


def test_predictions_are_shifted_to_its_own_tare(model) -> None:
    bare, tared = ObjectResiduals(model), ObjectResiduals(model, Touch.from_vector(REST + 40.0))
    add_all(bare, SAMPLES[:3])
    add_all(tared, SAMPLES[:3])
    assert_allclose(tared.means()[0], bare.means()[0] + 40.0)
    assert_array_equal(tared.means()[1], bare.means()[1])


def test_the_order_of_touches_does_not_matter(model) -> None:
    one, other = ObjectResiduals(model), ObjectResiduals(model)
    add_all(one, SAMPLES[:5])
    add_all(other, SAMPLES[4::-1])
    assert_allclose(one.means(), other.means(), rtol=1e-12)


def spoiled(index: int, value: float) -> Touch:
    vector = SAMPLES[0].touch.vector()
    vector[index] = value
    return Touch.from_vector(vector)


@pytest.mark.parametrize(
    ("reading", "rule"),
    [
        (spoiled(0, np.nan), "touched: pdc_th: nan is not between"),
        (spoiled(1, -22072.0), "touched: pdc_mf: -22072"),
        (spoiled(7, 0.0), r"touched: e_th\[5\]: 0"),
        (Touch(2700.0, 1800.0, np.full(24, 3000.0), np.zeros(24)), "touched: e_mf: all 24 electrodes are 0"),
    ],
)
def test_a_reading_of_dead_sensors_changes_nothing(model, reading: Touch, rule: str) -> None:
    residuals = ObjectResiduals(model)
    add_all(residuals, SAMPLES[:2])
    before = np.array(residuals.means())
    with pytest.raises(TactileError, match=rule):
        residuals.add(SAMPLES[2].cloud, SAMPLES[2].grasp, reading)
    assert residuals.count == 2
    assert_array_equal(residuals.means(), before)


def test_a_cloud_that_cannot_be_used_changes_nothing(model) -> None:
    residuals = ObjectResiduals(model)
    add_all(residuals, SAMPLES[:2])
    before = np.array(residuals.means())
    with pytest.raises(CloudError, match="fewer than 8"):
        residuals.add(Cloud(np.zeros((3, 3), np.float32)), SAMPLES[2].grasp, SAMPLES[2].touch)
    assert residuals.count == 2
    assert_array_equal(residuals.means(), before)


def test_a_tare_of_dead_sensors_is_refused(model) -> None:
    residuals = ObjectResiduals(model, Touch.from_vector(np.zeros(50)))
    with pytest.raises(TactileError, match="tare: pdc_th: 0 is not between"):
        residuals.add(SAMPLES[0].cloud, SAMPLES[0].grasp, SAMPLES[0].touch)
    assert residuals.count == 0


def test_a_model_without_calibration_cannot_adapt() -> None:
    residuals = ObjectResiduals(TouchModel(small_estimator(), CARD))
    with pytest.raises(ModelError, match="small: cannot adapt to touches: its card holds no calibration"):
        residuals.add(SAMPLES[0].cloud, SAMPLES[0].grasp, SAMPLES[0].touch)
    assert residuals.count == 0
