# SPDX-License-Identifier: Apache-2.0
"""The contact model calibrated: equal to the released model's predictions, with intervals from held-out samples."""

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, with_tares
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal
from recording_builders import read_folder

from foretouch.errors import DatasetError
from foretouch.models.contact.estimator import save_contact
from foretouch.models.hand_history import HandHistory
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import BIOTAC
from foretouch.types import GraspSample
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.training.calibration import HeldOutPredictions, calibration_folds, fit_group
from foretouch_lab.learning.training.contact import ContactPredictor, describe_samples, fit_contact

BARE = make_samples(5, 10)
TARED = with_tares(BARE, drift=60.0)


@pytest.fixture(scope="module")
def bare() -> ContactPredictor:
    """Fitted to four objects that were recorded without tares."""
    return ContactPredictor(BARE[:40], labels_of(BARE[:40]), FEW_TREES)


@pytest.fixture(scope="module")
def tared() -> ContactPredictor:
    """Fitted to the same with tares, whose sensors drift."""
    return ContactPredictor(TARED[:40], labels_of(TARED[:40]), FEW_TREES)


def by_touch_model(model: TouchModel, touched: list[GraspSample], sample: GraspSample) -> np.ndarray:
    """(2, 50) value and half width by the history of a hand."""
    history = HandHistory(model)
    for one in touched:
        history.add_touch(one.stamp_ns, one.cloud, one.grasp, one.touch)
    read = history.snapshot(max([sample.stamp_ns, *(one.stamp_ns for one in touched)]), same_object=True)
    (found,) = model.predict(sample.cloud, [sample.grasp], history=read)
    return np.array([found.value.values, found.upper.values - found.value.values])


def test_predictions_after_touches_are_those_of_the_touch_model(tared, tmp_path) -> None:
    card = save_contact(tmp_path, "toy", tared.estimator, {}, tared.calibration)
    model, remaining = load_model(card), TARED[44:]

    def check(touches: int) -> None:
        touched = TARED[40 : 40 + touches]
        found = tared.intervals_after(touched[::-1], remaining)
        wanted = [by_touch_model(model, touched, sample) for sample in remaining]
        assert_allclose(np.swapaxes(found, 0, 1), wanted, atol=1e-9)
        assert_array_equal(tared.predict_after(touched, remaining), found[0])

    every_case([(touches,) for touches in (0, 1, 3)], check)


def test_without_touches_it_is_the_estimate_from_vision_and_touches_help_on_a_new_object(bare) -> None:
    remaining = BARE[40:]
    wanted, _ = bare.estimator.predict_rows(describe_samples(remaining))
    assert_array_equal(bare.predict(remaining), wanted)
    assert_array_equal(bare.predict_after([], remaining), wanted)
    touched, others = BARE[40:43], BARE[43:]
    before, after = (np.abs(bare.predict_after(one, others) - labels_of(others)).mean() for one in ([], touched))
    assert after < before


def test_labels_and_tares_of_predicted_samples_are_not_used(tared) -> None:
    blind = [replace(sample, id=f"blind/{k}", touch=None, tare=None) for k, sample in enumerate(TARED[40:])]
    assert_array_equal(tared.predict(blind), tared.predict(TARED[40:]))


def test_rest_comes_from_tares_where_they_were_recorded(bare, tared) -> None:
    assert (bare.rest_recorded, tared.rest_recorded) == (False, True)
    assert_allclose(tared.rest, np.mean([sample.tare.values for sample in TARED[:40]], axis=0))
    assert_array_equal(tared.calibration[0].rest, tared.rest)


@pytest.mark.parametrize("name", ["known", "new"])
def test_calibration_is_that_of_models_that_never_saw_the_sample(bare, name: str) -> None:
    rows, labels = describe_samples(BARE[:40]), labels_of(BARE[:40])
    objects = np.array([sample.object for sample in BARE[:40]])
    folds, sessions = calibration_folds(BARE[:40], 0)[name]
    predicted = np.empty_like(labels)
    for fold in folds:
        fitted = fit_contact(rows[fold.train], labels[fold.train], list(objects[fold.train]), FEW_TREES)
        predicted[fold.test] = fitted.predict_rows(rows[fold.test])[0]
    wanted = fit_group(HeldOutPredictions(predicted, labels, objects, sessions, BIOTAC), new=name == "new")
    found = bare.calibration[0].groups[name]
    for field in ("between", "within", "difference_shrinkage", "spread", "half_width"):
        assert_allclose(getattr(found, field), getattr(wanted, field))
    assert bare.calibration[1]["regimes"][name]["objects"] == 4


def test_new_objects_are_held_out_whole_known_ones_in_stretches_of_time() -> None:
    samples = BARE[:40]
    found = calibration_folds(samples, 0)
    for fold in found["new"][0]:
        assert {samples[i].object for i in fold.test}.isdisjoint({samples[i].object for i in fold.train})
    assert_array_equal(found["new"][1], [sample.object for sample in samples])
    folds, sessions = found["known"]
    assert len(folds) == 5
    assert len(np.unique(sessions)) == 5 * 4
    for name in np.unique(sessions):
        mine = np.flatnonzero(sessions == name)
        assert len({samples[i].object for i in mine}) == 1
        assert mine[-1] - mine[0] == len(mine) - 1  # the samples are in order of time
    few = calibration_folds([sample for k, sample in enumerate(samples) if k % 10 < 3], 0)
    assert sorted(np.concatenate([fold.test for fold in few["known"][0]])) == list(range(12))


def test_missing_readings_are_refused_and_one_object_alone_is_not_calibrated(bare) -> None:
    with pytest.raises(DatasetError, match=f"{BARE[41].id}: touch: is not labelled"):
        bare.predict_after([BARE[40], replace(BARE[41], touch=None)], BARE[43:])
    alone = ContactPredictor(BARE[:10], labels_of(BARE[:10]), FEW_TREES)
    assert np.isfinite(alone.predict(BARE[10:20])).all()
    with pytest.raises(DatasetError, match=r"folds: all samples are of .*; to keep groups apart takes 2"):
        _ = alone.calibration


@pytest.mark.real_data
def test_intervals_narrow_on_real_grasps_and_hold_most_of_what_was_read(real_data) -> None:
    samples = read_folder(real_data / "vision2tactile")[::9]
    held = max({sample.object for sample in samples}, key=[sample.object for sample in samples].count)
    train, remaining = ([s for s in samples if (s.object == held) is inside] for inside in (False, True))
    fitted = ContactPredictor(train, labels_of(train), FEW_TREES)
    counts, half = fitted.intervals_after(remaining[:3], remaining[3:])
    before = fitted.intervals_after([], remaining[3:])[1]
    assert half.mean() < before.mean()
    assert (np.abs(counts - labels_of(remaining[3:])) <= half).mean() > 0.6
