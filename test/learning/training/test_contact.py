# SPDX-License-Identifier: Apache-2.0
"""Fitting the contact model: scikit-learn's own answers, a ridge chosen on objects, and what cannot be fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import CAMERA, labels_of, with_tares
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import LeaveOneGroupOut

from foretouch.errors import ConfigError, DatasetError
from foretouch.learning.data import object_folds
from foretouch.learning.training.calibration import rest_level, resting_labels
from foretouch.learning.training.contact import ContactConfig, describe_samples, fit_contact
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.contact.features import FEATURES, ContactScene
from foretouch.tactile import MODALITIES, columns

SAMPLES = make_samples(5, 10)
RIDGES = (0.01, 0.3, 3.0, 30.0)
KERNEL_ONLY = ContactConfig(trees=1, ridges=RIDGES, features="camera", thinned=1.0)


def kernel_ridge(rows: np.ndarray, targets: np.ndarray, ridge: float, decay: float) -> tuple[KernelRidge, Callable]:
    """scikit-learn's, and what standardises its rows."""
    mean, deviation = rows.mean(axis=0), rows.std(axis=0)
    deviation[deviation < 1e-9] = 1.0
    model = KernelRidge(alpha=ridge, kernel="laplacian", gamma=decay / rows.shape[1])
    return model.fit((rows - mean) / deviation, targets), lambda test: (test - mean) / deviation


def chosen_ridge(estimator: ContactEstimator, rows: np.ndarray, labels: np.ndarray, config: ContactConfig) -> float:
    """The ridge that scikit-learn needs for the same weights."""
    scaled = (labels - estimator.mean) / estimator.deviation
    for ridge in config.ridges:
        model, _ = kernel_ridge(rows, scaled, ridge, config.decay)
        if np.allclose(model.dual_coef_, estimator.kernel.weight, atol=1e-5):
            return ridge
    pytest.fail("the kernel's weights belong to no ridge")


def best_ridge(rows: np.ndarray, labels: np.ndarray, objects: list[str], config: ContactConfig) -> float:
    """By scikit-learn, one object left out at a time."""
    scaled = (labels - labels.mean(axis=0)) / labels.std(axis=0)
    errors = np.zeros((len(config.ridges), 50))
    for train, test in LeaveOneGroupOut().split(rows, groups=objects):
        mean = scaled[train].mean(axis=0)
        for k, ridge in enumerate(config.ridges):
            model, standard = kernel_ridge(rows[train], scaled[train] - mean, ridge, config.decay)
            errors[k] += ((model.predict(standard(rows[test])) + mean - scaled[test]) ** 2).sum(axis=0)
    by_modality = [errors[:, columns([name])].mean(axis=1) for name in MODALITIES]
    return config.ridges[int(np.argmin(np.mean(by_modality, axis=0)))]


def made(rng: np.random.Generator, carries_over: bool) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Rows and labels of six objects: labels follow from the row, or are an object's own."""
    objects = [f"object{k // 15}" for k in range(90)]
    rows = rng.normal(size=(90, len(FEATURES)))
    slope = rng.normal(size=(len(FEATURES), 50)) / np.sqrt(len(FEATURES))
    own = np.repeat(rng.normal(size=(6, 50)), 15, axis=0)
    rows += np.repeat(1.5 * rng.normal(size=(6, len(FEATURES))), 15, axis=0)
    labels = rows @ slope if carries_over else own
    return rows, 3000.0 + 50.0 * labels + rng.normal(size=(90, 50)), objects


def test_samples_are_described_each_on_its_own_cloud() -> None:
    rows = describe_samples(SAMPLES[:3], "camera")
    for row, sample in zip(rows, SAMPLES, strict=False):
        assert_array_equal(row, ContactScene(sample.cloud.xyz).describe([sample.grasp])[0])


def test_rest_is_the_mean_of_tares_where_there_are_any() -> None:
    tared = with_tares(SAMPLES[:4], drift=30.0)
    rest, recorded = rest_level([*tared, SAMPLES[5]])
    assert recorded
    assert_allclose(rest, np.mean([sample.tare.vector() for sample in tared], axis=0))


def test_without_tares_rest_is_the_end_of_the_labels_that_is_without_pressure() -> None:
    """PDC rises with pressure, so rest is their low end; electrodes fall, so it is their high end."""
    labels = np.tile(np.arange(1.0, 102.0)[:, None], (1, 50))
    samples = [replace(SAMPLES[0], touch=type(SAMPLES[0].touch).from_vector(row)) for row in labels]
    rest, recorded = rest_level(samples)
    assert not recorded
    assert_allclose(rest, [2.0, 2.0, *[96.0] * 48])


def test_labels_at_rest_are_free_of_drift() -> None:
    calm, drifting = with_tares(SAMPLES, drift=0.0), with_tares(SAMPLES, drift=50.0)
    rest = calm[0].tare.vector()
    assert_allclose(resting_labels(drifting, labels_of(drifting), rest), labels_of(calm), atol=1e-9)
    assert_array_equal(resting_labels(SAMPLES, labels_of(SAMPLES), rest), labels_of(SAMPLES))
    labels = labels_of(drifting)
    resting_labels(drifting, labels, rest)
    assert_array_equal(labels, labels_of(drifting))  # the caller's are left alone


@pytest.mark.parametrize(("count", "folds"), [(2, 2), (10, 10), (11, 10), (37, 10)])
def test_objects_stay_whole_in_at_most_ten_folds(count: int, folds: int) -> None:
    objects = [f"o{k % count:02}" for k in range(3 * count)]
    found = object_folds(objects)
    assert len(found) == folds
    for fold in found:
        held = {objects[i] for i in fold.test}
        assert held.isdisjoint({objects[i] for i in fold.train})
        assert len(fold.test) == 3 * len(held)
    assert sorted(np.concatenate([fold.test for fold in found])) == list(range(3 * count))
    assert [f.name for f in object_folds(objects)] == [f.name for f in found]


def test_one_object_cannot_be_left_out() -> None:
    with pytest.raises(DatasetError, match=r"folds: all samples are of .*; to keep groups apart takes 2"):
        object_folds(["only"] * 20)


def test_forests_are_scikit_learn_s() -> None:
    rows, labels = describe_samples(SAMPLES, "camera"), labels_of(SAMPLES)
    config = CAMERA.replace(trees=6, leaf=2, feature_share=0.5, seed=3)
    estimator = fit_contact(rows, labels, [sample.object for sample in SAMPLES], config)
    scaled = (labels - labels.mean(axis=0)) / labels.std(axis=0)
    for name, column in (("together", np.arange(50)), *((name, columns([name])) for name in MODALITIES)):
        target = scaled[:, column] if len(column) > 1 else scaled[:, column[0]]
        theirs = ExtraTreesRegressor(6, min_samples_leaf=2, max_features=0.5, random_state=3).fit(rows, target)
        wanted = theirs.predict(rows).reshape(len(rows), -1)
        # Leaves are rounded to float16: 5e-4 of values below 4 deviations.
        assert_allclose(estimator.forests[name].predict(rows), wanted, atol=2e-3)


@pytest.mark.parametrize("carries_over", [True, False])
def test_the_ridge_is_what_objects_left_out_prefer(rng, carries_over: bool) -> None:
    rows, labels, objects = made(rng, carries_over)
    estimator = fit_contact(rows, labels, objects, KERNEL_ONLY)
    found = chosen_ridge(estimator, rows, labels, KERNEL_ONLY)
    assert found == best_ridge(rows, labels, objects, KERNEL_ONLY)
    assert (found < 1.0) is carries_over  # it claims no more than carries over


def test_it_is_chosen_by_objects_and_not_by_samples(rng) -> None:
    """Where labels are an object's own, leaving single samples out would take the smallest ridge."""
    rows, labels, objects = made(rng, carries_over=False)
    by_object, by_sample = (
        chosen_ridge(fit_contact(rows, labels, names, KERNEL_ONLY), rows, labels, KERNEL_ONLY)
        for names in (objects, [f"{k % 9}" for k in range(90)])
    )
    assert by_object == max(RIDGES)
    assert by_sample < by_object


def test_a_single_object_tells_nothing_of_others(rng) -> None:
    rows, labels, _ = made(rng, carries_over=True)
    estimator = fit_contact(rows, labels, ["only"] * 90, KERNEL_ONLY)
    assert chosen_ridge(estimator, rows, labels, KERNEL_ONLY) == max(RIDGES)


def test_the_same_seed_gives_the_same_bits_and_another_does_not() -> None:
    rows, labels, objects = (
        describe_samples(SAMPLES, "camera"),
        labels_of(SAMPLES),
        [sample.object for sample in SAMPLES],
    )
    one, again, other = (
        fit_contact(rows, labels, objects, CAMERA.replace(seed=seed)).to_tensors() for seed in (1, 1, 2)
    )
    assert set(one) == set(again)
    for name, array in one.items():
        assert_array_equal(array, again[name])
    assert not np.array_equal(one["forest_together/threshold"], other["forest_together/threshold"])


def test_too_few_samples_are_refused() -> None:
    rows, labels = describe_samples(SAMPLES[:4], "camera"), labels_of(SAMPLES[:4])
    with pytest.raises(DatasetError, match="contact model: 4 samples are fewer than 5"):
        fit_contact(rows, labels, ["a", "a", "b", "b"], CAMERA)


@pytest.mark.parametrize("constant", [3000.0, 0.1])
def test_a_label_that_never_changes_is_refused_by_its_place(constant: float) -> None:
    """The mean of fifty times 0.1 is not 0.1: a deviation would not show it."""
    rows, labels = describe_samples(SAMPLES, "camera"), labels_of(SAMPLES)
    labels[:, 17] = constant
    with pytest.raises(DatasetError, match="contact model: value 17 of the touch is the same in all samples"):
        fit_contact(rows, labels, [sample.object for sample in SAMPLES], CAMERA)


def test_settings_out_of_bounds_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"ridges: .* must hold at least one"):
        ContactConfig(ridges=())
    with pytest.raises(ConfigError, match="decay"):
        ContactConfig(decay=0.0)
    with pytest.raises(ConfigError, match="tree: unknown setting"):
        ContactConfig.from_mapping({"tree": 3})
