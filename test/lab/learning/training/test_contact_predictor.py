# SPDX-License-Identifier: Apache-2.0
"""The contact model calibrated: intervals from held-out samples, which narrow with touches."""

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import FEW_TREES
from experiment_samples import make_samples
from numpy.testing import assert_allclose
from recording_builders import read_folder

from foretouch import fit
from foretouch.errors import ConfigError
from foretouch.models.card import CardCalibration
from foretouch.models.touch_model import History
from foretouch.tactile import BIOTAC
from foretouch.types import Sample
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.learning.data import labels_of, load_dataset
from foretouch_lab.learning.data.dataset import dataset_of
from foretouch_lab.learning.data.folds import predict_folds
from foretouch_lab.learning.training.calibration import HeldOutPredictions, calibration_folds, fit_group, guarantee
from foretouch_lab.learning.training.contact import describe_samples, fit_contact
from foretouch_lab.learning.training.learners import make_learner
from foretouch_lab.learning.training.run_config import RunConfig, load_run_config

BARE = make_samples(5, 10)


def after_touches(history: History, touched: list[Sample], sample: Sample) -> np.ndarray:
    """(2, 50) value and half width by the history of a hand after touches of the same object."""
    hand = history.copy()
    for one in touched:
        hand.touched(one.cloud, one.grasp, one.touch, stamp_ns=one.stamp_ns, same_object=True)
    latest = max([sample.stamp_ns, *(one.stamp_ns for one in touched)])
    (found,) = hand.predict(sample.cloud, [sample.grasp], stamp_ns=latest, same_object=True)
    return np.array([found.value.values, found.upper.values - found.value.values])


@pytest.fixture(scope="module")
def calibrated() -> CardCalibration:
    """Of a model of four objects that were recorded without tares."""
    config = RunConfig(method="contact", contact=FEW_TREES)
    return make_learner(config, dataset_of(BARE[:40])).calibrate()


@pytest.mark.parametrize("name", ["known", "new"])
def test_calibration_is_that_of_models_that_never_saw_the_sample(calibrated, name: str) -> None:
    rows, labels = describe_samples(BARE[:40]), labels_of(BARE[:40])
    objects = np.array([sample.object for sample in BARE[:40]])
    folds, sessions = calibration_folds(BARE[:40], 0)[name]
    predicted = np.empty_like(labels)
    for fold in folds:
        fitted = fit_contact(rows[fold.train], labels[fold.train], list(objects[fold.train]), FEW_TREES)
        predicted[fold.test] = fitted.predict_rows(rows[fold.test])[0]
    wanted = fit_group(HeldOutPredictions(predicted, labels, objects, sessions, BIOTAC), new=name == "new")
    found = calibrated[0].groups[name]
    for field in ("between", "within", "difference_shrinkage", "spread", "half_width"):
        assert_allclose(getattr(found, field), getattr(wanted, field))
    assert calibrated[1]["regimes"][name]["objects"] == 4


@pytest.mark.real_data
def test_intervals_narrow_on_real_grasps_and_hold_most_of_what_was_read(real_data) -> None:
    samples = read_folder(real_data / "vision2tactile")[::9]
    held = max({sample.object for sample in samples}, key=[sample.object for sample in samples].count)
    train, remaining = ([s for s in samples if (s.object == held) is inside] for inside in (False, True))
    history = History(fit(train, "contact-v3", contact=FEW_TREES.to_mapping()))
    before, after = (
        np.array([after_touches(history, remaining[:touches], sample) for sample in remaining[3:]])
        for touches in (0, 3)
    )
    assert after[:, 1].mean() < before[:, 1].mean()
    assert (np.abs(after[:, 0] - labels_of(remaining[3:])) <= after[:, 1]).mean() > 0.6


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
