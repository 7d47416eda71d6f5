# SPDX-License-Identifier: Apache-2.0
"""Touches by where they were: against conditioning of the joint Gaussian, what they forget, and what moves with the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated_models import REST, make_calibration, make_tracked_calibration
from contact_model_builders import small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import ModelError
from foretouch.models.contact.features import CONDITIONS, FEATURES
from foretouch.models.similar_touches import MOST, SimilarTouches
from foretouch.models.state_space import TrackerParameters
from foretouch.models.touch_model import SIMILAR_TOUCHES, History, TouchModel
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC
from foretouch.types import Cloud, Grasp, Prediction, Sample

S, START = 10**9, 1_700_000_000 * 10**9
RATIO = np.array([3.0, 0.0, 1.0, 8.0])
SAMPLES = make_samples(2, 8)
FEATURE_COUNT = len(FEATURES) - len(CONDITIONS)


def local(parameters: TrackerParameters, scale: np.ndarray) -> TrackerParameters:
    """The parameters with places, of a finger that is never restarted."""
    return replace(parameters, where_scale=scale, where_ratio=RATIO, alarm=np.full((2, 2), 1e6))


PARAMETERS = local(make_calibration().tracker_parameters, np.array([0.5, 2.0, 1.0]))


@pytest.fixture(scope="module")
def model() -> TouchModel:
    calibration = make_tracked_calibration()
    scale = np.full(FEATURE_COUNT, 0.5)
    return TouchModel(
        small_estimator(),
        {"name": "small", "sha256": "0" * 64},
        replace(calibration, tracker=local(calibration.tracker_parameters, scale)),
    )


def read(model: TouchModel, samples: list[Sample]) -> History:
    history = History(model)
    for number, sample in enumerate(samples):
        history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=sample.stamp_ns, same_object=number > 0)
    return history


def predict(history: History, cloud: Cloud, grasp: Grasp, *, same: bool = True) -> Prediction:
    at = history.at(SAMPLES[-1].stamp_ns, same_object=same)
    (found,) = history.model.predict(cloud, [grasp], history=at)
    return found


def test_it_conditions_the_joint_gaussian(rng: np.random.Generator) -> None:
    where, asked = rng.normal(size=(9, 3)), rng.normal(size=(4, 3))
    readings, level = rng.normal(2000.0, 50.0, (9, 50)), rng.normal(2000.0, 50.0, 50)
    found, share = SimilarTouches(PARAMETERS, where, readings).regress(asked, level)
    places = np.vstack([where, asked]) / PARAMETERS.where_scale
    distance = np.sqrt(((places[:, None] - places) ** 2).sum(axis=2))
    kernel = (1.0 + distance) * np.exp(-distance)
    for k, columns in enumerate(BIOTAC.modality_columns.values()):
        joint = RATIO[k] * kernel + np.eye(13)
        weights = np.linalg.solve(joint[:9, :9], joint[:9, 9:]).T
        assert_allclose(found[:, columns], weights @ (readings - level)[:, columns], rtol=1e-9, atol=1e-9)
        left = np.diag(joint[9:, 9:]) - (weights * joint[9:, :9]).sum(axis=1)
        assert_allclose(share[:, k], left / (1.0 + RATIO[k]), rtol=1e-9)
    touches = SimilarTouches(PARAMETERS, where, readings)
    for k in range(len(asked)):  # each grasp as alone, to the bit
        for whole, alone in zip((found, share), touches.regress(asked[k : k + 1], level), strict=True):
            assert_array_equal(whole[k], alone[0])


def grasped(count: int, where: np.ndarray, residual: float = 40.0) -> SensorTracker:
    tracker = SensorTracker(PARAMETERS)
    for k in range(count):
        own = where if k % 2 else -where  # alternately at two places, which read differently
        tracker.add_touch(START + k * 60 * S, REST + (residual if k % 2 else -residual), REST, where=own)
    return tracker


def test_places_take_part_from_the_third_touch_on_and_only_where_they_are_alike() -> None:
    here, far = np.ones(3), np.full(3, 1e3)
    for count in (1, 2, 3, 8):
        tracker = grasped(count, here)
        level = tracker.level(START + count * 60 * S)
        plain, width = tracker.adapt(level, REST[None])
        alike, narrow = tracker.adapt(level, REST[None], here[None])
        assert_array_equal(tracker.adapt(level, REST[None], far[None])[0], plain)
        assert_array_equal(tracker.adapt(level, REST[None], far[None])[1], width)
        if count < 3:
            assert_array_equal(alike, plain)
            continue
        moved = (alike - plain)[0]
        assert_array_equal(moved[BIOTAC.columns(["PDC_MF"])], 0.0)  # whose ratio is 0
        others = BIOTAC.columns(["PDC_TH", "E_TH", "E_MF"])
        assert (narrow[0, others] < width[0, others]).all()
        assert (moved[others] > 5.0).all() or count == 3


def test_they_end_with_the_object_and_with_a_restart_and_do_not_grow() -> None:
    tracker = grasped(MOST + 9, np.ones(3))
    assert len(tracker.similar.where) == MOST
    touched = tracker.copy()
    tracker.start_object()
    assert not len(tracker.similar.where)
    assert len(touched.similar.where) == MOST
    strict = replace(PARAMETERS, alarm=np.full((2, 2), 3.0))
    tracker = SensorTracker(strict)
    for k in range(5):
        assert not tracker.add_touch(START + k * 60 * S, REST, REST, where=np.ones(3))
    assert len(tracker.similar.where) == 5
    jumped = [tracker.add_touch(START + k * 60 * S, REST - 900.0, REST, where=np.ones(3)) for k in (6, 7)]
    assert jumped == [(), BIOTAC.fingers]
    assert not len(tracker.similar.where)  # neither those before the jump nor those that failed the test


def test_a_state_continues_to_the_bit_and_older_ones_are_read() -> None:
    tracker, here = grasped(7, np.ones(3)), np.ones((1, 3))
    again = SensorTracker.from_tensors(PARAMETERS, tracker.to_tensors())
    at = START + 500 * S
    for one, other in zip(*(who.adapt(who.level(at), REST[None], here) for who in (tracker, again)), strict=True):
        assert_array_equal(one, other)
    older = {name: array for name, array in tracker.to_tensors().items() if not name.startswith("where")}
    plain = SensorTracker.from_tensors(PARAMETERS, older)
    assert (plain.touches, len(plain.similar.where)) == (7, 0)
    assert_array_equal(plain.level(at).offset, tracker.level(at).offset)

    for name, value in (("where", np.zeros((7, 2))), ("where_readings", np.full((7, 50), 1e9))):
        with pytest.raises(ModelError, match=r"^where"):
            SensorTracker.from_tensors(PARAMETERS, {**tracker.to_tensors(), name: value})


def test_a_flag_names_predictions_in_which_they_took_part(model: TouchModel) -> None:
    one = SAMPLES[7]
    for count, same in ((2, True), (3, True), (6, True), (6, False)):
        found = predict(read(model, SAMPLES[:count]), one.cloud, one.grasp, same=same)
        assert (SIMILAR_TOUCHES in found.flags) == (same and count >= 3)
        assert found.reference == ("touches" if same else "history")
