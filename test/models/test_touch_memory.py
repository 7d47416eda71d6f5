# SPDX-License-Identifier: Apache-2.0
"""Readings on one object: what is kept of them, and what is not taken in."""

from __future__ import annotations

import numpy as np
import pytest
from contact_model_builders import labels_of, small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal
from trust_builders import REST, make_calibration

from foretouch.errors import CloudError, ModelError, TactileError
from foretouch.models.touch_memory import TouchMemory
from foretouch.models.touch_model import TouchModel
from foretouch.types import Cloud, Touch

CARD = {"name": "small", "sha256": "0" * 64}
SAMPLES = make_samples(2, 6)


@pytest.fixture
def model() -> TouchModel:
    return TouchModel(small_estimator(), CARD, make_calibration())


def take_in(memory: TouchMemory, samples) -> None:
    for sample in samples:
        memory.add(sample.cloud, sample.grasp, sample.touch)


def test_it_keeps_means_of_what_was_expected_and_read(model) -> None:
    memory = TouchMemory(model)
    assert memory.count == 0
    assert_array_equal(memory.means(), np.zeros((2, 50)))
    take_in(memory, SAMPLES[:4])
    expected, read = memory.means()
    assert memory.count == 4
    assert_allclose(read, labels_of(SAMPLES[:4]).mean(axis=0))
    assert_allclose(expected, np.mean([model.expect(s.cloud, [s.grasp])[0] for s in SAMPLES[:4]], axis=0))


def test_what_was_expected_is_told_at_its_own_tare(model) -> None:
    bare, tared = TouchMemory(model), TouchMemory(model, Touch.from_vector(REST + 40.0))
    take_in(bare, SAMPLES[:3])
    take_in(tared, SAMPLES[:3])
    assert_allclose(tared.means()[0], bare.means()[0] + 40.0)
    assert_array_equal(tared.means()[1], bare.means()[1])


def test_the_order_of_touches_does_not_matter(model) -> None:
    one, other = TouchMemory(model), TouchMemory(model)
    take_in(one, SAMPLES[:5])
    take_in(other, SAMPLES[4::-1])
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
    memory = TouchMemory(model)
    take_in(memory, SAMPLES[:2])
    before = np.array(memory.means())
    with pytest.raises(TactileError, match=rule):
        memory.add(SAMPLES[2].cloud, SAMPLES[2].grasp, reading)
    assert memory.count == 2
    assert_array_equal(memory.means(), before)


def test_a_cloud_that_cannot_be_used_changes_nothing(model) -> None:
    memory = TouchMemory(model)
    take_in(memory, SAMPLES[:2])
    before = np.array(memory.means())
    with pytest.raises(CloudError, match="fewer than 8"):
        memory.add(Cloud(np.zeros((3, 3), np.float32)), SAMPLES[2].grasp, SAMPLES[2].touch)
    assert memory.count == 2
    assert_array_equal(memory.means(), before)


def test_a_tare_of_dead_sensors_is_refused(model) -> None:
    memory = TouchMemory(model, Touch.from_vector(np.zeros(50)))
    with pytest.raises(TactileError, match="tare: pdc_th: 0 is not between"):
        memory.add(SAMPLES[0].cloud, SAMPLES[0].grasp, SAMPLES[0].touch)
    assert memory.count == 0


def test_a_model_without_calibration_cannot_learn() -> None:
    memory = TouchMemory(TouchModel(small_estimator(), CARD))
    with pytest.raises(ModelError, match="small: cannot learn from touches: its card holds no calibration"):
        memory.add(SAMPLES[0].cloud, SAMPLES[0].grasp, SAMPLES[0].touch)
    assert memory.count == 0
