# SPDX-License-Identifier: Apache-2.0
"""Levels of a model: cheaper forms of it that need no training."""

import numpy as np
import pytest
from contact_model_builders import CAMERA, FEW_TREES
from experiment_samples import make_samples

from foretouch.errors import ModelError
from foretouch.learning.data import labels_of
from foretouch.learning.training.contact import describe_samples, fit_contact
from foretouch.models import load_model
from foretouch.models.contact.cheaper import WithoutSurroundings, fewer_trees
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.registry import available_models
from foretouch.tradeoff.budget.levels import MEAN, known_levels, levels_of
from foretouch.tradeoff.budget.profile import profile_scene


def fitted(trees: int, config=FEW_TREES) -> tuple[ContactEstimator, np.ndarray]:
    samples = make_samples()
    rows = describe_samples(samples, config.features)
    objects = [sample.object for sample in samples]
    return fit_contact(rows, labels_of(samples), objects, config.replace(trees=trees)), rows


def test_fewer_trees_are_those_of_a_smaller_fit() -> None:
    large, rows = fitted(4)
    small, _ = fitted(2)
    np.testing.assert_array_equal(fewer_trees(large, 2).predict_rows(rows)[0], small.predict_rows(rows)[0])
    np.testing.assert_array_equal(fewer_trees(large, 9).predict_rows(rows)[0], large.predict_rows(rows)[0])
    for forest in fewer_trees(large, 2).forests.values():
        forest._check()


def test_without_surroundings_no_point_near_a_contact_matters() -> None:
    estimator = WithoutSurroundings.of(load_model("contact-v2").estimator)
    cloud, grasps = profile_scene(3)
    full = load_model("contact-v2").estimator.estimate(cloud, grasps)
    plain = estimator.estimate(cloud, grasps)
    assert np.abs(plain.counts - full.counts).max() > 1e-3
    np.testing.assert_array_equal(plain.in_distribution, full.in_distribution)
    large, rows = fitted(4)
    changed = rows.copy()
    changed[:, -14:] += 1.0  # the second contact
    plain = WithoutSurroundings.of(large)
    np.testing.assert_array_equal(plain.predict_rows(rows)[0], plain.predict_rows(changed)[0])
    with pytest.raises(ModelError, match="camera's frame"):
        WithoutSurroundings.of(fitted(2, CAMERA)[0])


def test_levels_of_the_default_model_descend_to_the_mean() -> None:
    model = load_model()
    levels = levels_of(model)
    skills = [level.skill for level in levels]
    assert levels[0].model is model
    assert levels[-1].name == MEAN
    assert len(levels) >= 4
    assert skills == sorted(skills, reverse=True)
    cloud, grasps = profile_scene(2)
    first = model.predict(cloud, grasps)[0]
    for level in levels[1:]:
        found = level.model.predict(cloud, grasps)[0]
        assert level.model.sha256 == model.sha256
        assert found.status == "ok"
        width = found.upper.pdc_th - found.lower.pdc_th
        assert width >= 0.999 * (first.upper.pdc_th - first.lower.pdc_th)  # never narrower than the model's
    mean = levels[-1].model.predict(cloud, grasps)[0]
    assert mean.flags == ("unfamiliar",)
    np.testing.assert_allclose(mean.value.vector(), model.estimator.mean)


def test_known_levels_are_of_models_of_the_package() -> None:
    shipped = {load_model(name).sha256 for name in available_models()}
    assert known_levels().keys() <= shipped
    assert load_model().sha256 in known_levels()


def test_a_model_of_ones_own_has_itself_and_its_mean() -> None:
    model = load_model("touchnet-v1")
    if model.sha256 not in known_levels():
        assert [level.name for level in levels_of(model)] == ["touchnet-v1"]
    assert [level.name for level in levels_of(load_model("contact-v1"))] == ["contact-v1", MEAN]
    assert levels_of(load_model("contact-v1"))[1].skill is None
