# SPDX-License-Identifier: Apache-2.0
"""The contact model calibrated: equal to the released model's predictions, with intervals from held-out samples."""

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, with_tares
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose
from recording_builders import read_folder

from foretouch.errors import ConfigError
from foretouch.models.contact.estimator import save_contact
from foretouch.models.registry import load_model
from foretouch.models.touch_model import History, TouchModel
from foretouch.tactile import BIOTAC
from foretouch.types import Sample
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.learning.data import labels_of, load_dataset
from foretouch_lab.learning.data.dataset import dataset_of
from foretouch_lab.learning.data.folds import predict_folds
from foretouch_lab.learning.training.calibration import HeldOutPredictions, calibration_folds, fit_group, guarantee
from foretouch_lab.learning.training.contact import ContactPredictor, describe_samples, fit_contact
from foretouch_lab.learning.training.learners import make_learner
from foretouch_lab.learning.training.run_config import load_run_config

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


def by_touch_model(model: TouchModel, touched: list[Sample], sample: Sample) -> np.ndarray:
    """(2, 50) value and half width by the history of a hand."""
    history = History(model)
    for one in touched:
        history.touched(one.cloud, one.grasp, one.touch, stamp_ns=one.stamp_ns, same_object=True)
    read = history.at(max([sample.stamp_ns, *(one.stamp_ns for one in touched)]), same_object=True)
    (found,) = model.predict(sample.cloud, [sample.grasp], history=read)
    return np.array([found.value.values, found.upper.values - found.value.values])


def test_predictions_after_touches_are_those_of_the_touch_model(tared, tmp_path) -> None:
    card = save_contact(tmp_path, "toy", tared.estimator, {}, tared.calibration)
    model, remaining = load_model(card), TARED[44:]

    def check(touches: int) -> None:
        touched = TARED[40 : 40 + touches]
        found = tared.predict_after(touched[::-1], remaining)
        wanted = [by_touch_model(model, touched, sample) for sample in remaining]
        assert_allclose(np.swapaxes(found, 0, 1), wanted, atol=1e-9)

    every_case([(touches,) for touches in (0, 1, 3)], check)


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


@pytest.mark.real_data
def test_intervals_narrow_on_real_grasps_and_hold_most_of_what_was_read(real_data) -> None:
    samples = read_folder(real_data / "vision2tactile")[::9]
    held = max({sample.object for sample in samples}, key=[sample.object for sample in samples].count)
    train, remaining = ([s for s in samples if (s.object == held) is inside] for inside in (False, True))
    fitted = ContactPredictor(train, labels_of(train), FEW_TREES)
    counts, half = fitted.predict_after(remaining[:3], remaining[3:])
    before = fitted.predict_after([], remaining[3:])[1]
    assert half.mean() < before.mean()
    assert (np.abs(counts - labels_of(remaining[3:])) <= half).mean() > 0.6


def test_whole_shapes_are_left_out_where_the_training_asks_for_it(tmp_path) -> None:
    scene = {"objects": [{"name": f"{shape}_{k}", "shape": shape} for shape in ("can", "box") for k in range(2)]}
    named = [replace(sample, object=scene["objects"][k // 10]["name"]) for k, sample in enumerate(BARE[:40])]
    with StoreWriter(tmp_path / "store", {"scene": scene, "scene_sha256": "0" * 64}) as writer:
        for sample in named:
            writer.write(sample)
    data = load_dataset(tmp_path / "store")
    config = load_run_config("contact", ["contact.trees=3", "left_out=shapes"])
    learner = make_learner(config, data)
    folds, sessions = calibration_folds(learner.samples, 0, learner.shapes)["new"]
    assert [fold.name for fold in folds] == ["box", "can"]
    assert len(set(sessions)) == 4  # what lasts is still an object's
    calibration, facts = learner.calibrate()
    assert (facts["left_out"], facts["regimes"]["new"]["objects"], facts["regimes"]["known"]["objects"]) == (
        "shapes",
        2,
        4,
    )
    by_shape = HeldOutPredictions(
        predict_folds({"new": (learner.predict_fold, folds)})["new"],
        learner.labels,
        np.array(learner.shapes),
        sessions,
        BIOTAC,
    )
    assert_allclose(calibration.groups["new"].half_width, fit_group(by_shape, new=True).half_width)
    assert "from 2 shapes, a distribution-free guarantee for one more cannot exceed 67%" in guarantee(facts)
    with pytest.raises(
        ConfigError, match="left_out: samples does not state the shape of campbells, as simulated data do"
    ):
        make_learner(config, dataset_of(BARE[:40]))
