# SPDX-License-Identifier: Apache-2.0
"""Fitting the contact model: scikit-learn's own answers, and what cannot be fitted."""

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import FEW_TREES
from experiment_samples import make_samples
from numpy.testing import assert_allclose
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.kernel_ridge import KernelRidge

from foretouch.errors import DatasetError
from foretouch.models.contact.features import CONDITIONS
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch.types import Cloud
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.training import contact
from foretouch_lab.learning.training.contact import describe_samples, fit_contact

SAMPLES = make_samples(5, 10)
OBJECTS = [sample.object for sample in SAMPLES]


def test_forests_and_kernel_are_scikit_learn_s(monkeypatch) -> None:
    rows, labels = describe_samples(SAMPLES), labels_of(SAMPLES)
    config = FEW_TREES.replace(trees=6, leaf=2, feature_share=0.5, seed=3)
    monkeypatch.setattr(contact, "_OBJECT_EFFECT", 0.0)
    monkeypatch.setattr(contact, "_RIDGES", (0.3,))
    estimator = fit_contact(rows, labels, OBJECTS, config)
    inputs, scaled = rows[:, len(CONDITIONS) :], (labels - labels.mean(axis=0)) / labels.std(axis=0)
    for name, column in (("together", np.arange(50)), *((name, BIOTAC.columns([name])) for name in MODALITIES)):
        target = scaled[:, column] if len(column) > 1 else scaled[:, column[0]]
        theirs = ExtraTreesRegressor(6, min_samples_leaf=2, max_features=0.5, random_state=3).fit(inputs, target)
        wanted = theirs.predict(inputs).reshape(len(rows), -1)
        # Leaves are rounded to float16: 5e-4 of values below 4 deviations.
        assert_allclose(estimator.forests[name].predict(inputs), wanted, atol=2e-3)
    deviation = inputs.std(axis=0)
    standard = (inputs - inputs.mean(axis=0)) / np.where(deviation > 1e-9, deviation, 1.0)
    ridge = KernelRidge(alpha=0.3, kernel="laplacian", gamma=contact.DECAY / inputs.shape[1])
    assert_allclose(estimator.kernel.predict(inputs), ridge.fit(standard, scaled).predict(standard), atol=1e-5)


def test_samples_that_cannot_be_fitted_are_refused() -> None:
    rows, labels = describe_samples(SAMPLES), labels_of(SAMPLES)
    with pytest.raises(DatasetError, match="contact model: 4 samples are fewer than 5"):
        fit_contact(rows[:4], labels[:4], ["a", "a", "b", "b"], FEW_TREES)
    with pytest.raises(DatasetError, match="contact model: 20001 samples exceed 20000, whose pairs its kernel holds"):
        fit_contact(np.tile(rows[:1], (20_001, 1)), np.tile(labels[:1], (20_001, 1)), ["a"] * 20_001, FEW_TREES)
    for constant in (3000.0, 0.1):  # the mean of fifty times 0.1 is not 0.1: a deviation would not show it
        labels[:, 17] = constant
        with pytest.raises(DatasetError, match="contact model: value 17 of the touch is the same in all samples"):
            fit_contact(rows, labels, OBJECTS, FEW_TREES)
    empty = replace(SAMPLES[0], cloud=Cloud(np.zeros((0, 3), np.float32)))
    with pytest.raises(DatasetError, match=f"{SAMPLES[0].id}: cloud: 0 finite points are fewer than 8"):
        describe_samples([empty])
