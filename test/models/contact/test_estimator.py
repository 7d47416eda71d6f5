# SPDX-License-Identifier: Apache-2.0
"""The contact model: forests in distribution, the kernel out of it, and grasps of one call independent of each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_model_builders import labels_of, named, scaled, small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.errors import CloudError, ModelError
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.contact.features import ContactScene
from foretouch.models.novelty import SHAPE_FEATURES, SizeNoveltyDetector
from foretouch.tactile import MODALITIES, P1_RANGES, P2_RANGES, columns
from foretouch.types import Cloud, Grasp

SAMPLES = make_samples(5, 10)


@pytest.fixture
def estimator() -> ContactEstimator:
    return small_estimator()


def span(estimator: ContactEstimator, low: float, high: float) -> ContactEstimator:
    """The same with scores of 1 up to the distance `low`, and of 0 from `high`."""
    novelty = estimator.novelty
    return replace(
        estimator, novelty=SizeNoveltyDetector(novelty.centre, novelty.scale, novelty.known, np.array([low, high]))
    )


def by_forests(estimator: ContactEstimator, rows: np.ndarray) -> np.ndarray:
    """The mean of the forest of all values and those of each modality, in counts."""
    found = np.empty((len(rows), 50))
    together = estimator.forests["together"].predict(rows)
    for name in MODALITIES:
        index = columns([name])
        found[:, index] = 0.5 * together[:, index] + 0.5 * estimator.forests[name].predict(rows)
    return found * estimator.deviation + estimator.mean


def by_kernel(estimator: ContactEstimator, rows: np.ndarray) -> np.ndarray:
    return estimator.kernel.predict(rows) * estimator.deviation + estimator.mean


def test_forests_predict_in_distribution_and_the_kernel_out_of_it(estimator) -> None:
    sample = SAMPLES[3]
    rows = ContactScene(sample.cloud.xyz).describe([sample.grasp])
    far = float(np.abs(estimator.novelty.known).max()) * 100.0
    known = span(estimator, far, 2 * far).estimate(sample.cloud, [sample.grasp])
    new = span(estimator, -2.0, -1.0).estimate(sample.cloud, [sample.grasp])
    assert_allclose(known.counts, by_forests(estimator, rows))
    assert_allclose(new.counts, by_kernel(estimator, rows))
    assert (known.in_distribution.tolist(), new.in_distribution.tolist()) == ([True], [False])


@pytest.mark.parametrize(("share", "inside"), [(0.25, False), (0.5, True), (0.75, True)])
def test_between_the_two_it_blends_and_the_flag_turns_at_a_half(estimator, share: float, inside: bool) -> None:
    sample = SAMPLES[3]
    scene = ContactScene(sample.cloud.xyz)
    novelty = estimator.novelty
    sizes = (named(scene.object_features, *SHAPE_FEATURES) - novelty.centre) / novelty.scale
    distance = np.sort(np.abs(novelty.known - sizes).sum(axis=1))[:3].mean()
    one = span(estimator, 0.0, distance / (1.0 - share) * (1.0 + 1e-9))  # so that the score is this share
    found = one.estimate(sample.cloud, [sample.grasp])
    rows = scene.describe([sample.grasp])
    wanted = share * by_forests(estimator, rows) + (1.0 - share) * by_kernel(estimator, rows)
    assert_allclose(found.counts, wanted, atol=1e-4)
    assert found.in_distribution.tolist() == [inside]


def test_it_predicts_its_training_samples(estimator) -> None:
    found = np.concatenate([estimator.estimate(one.cloud, [one.grasp]).counts for one in SAMPLES])
    actual = labels_of(SAMPLES)
    skill = 1.0 - ((found - actual) ** 2).mean(axis=0) / actual.var(axis=0)
    assert all(skill[columns([name])].mean() > 0.2 for name in MODALITIES)


def test_a_house_is_out_of_distribution_and_gets_about_the_mean(estimator) -> None:
    house = scaled(SAMPLES[0].cloud, 100.0)
    found = estimator.estimate(house, [Grasp(np.array([2.5, 0, 1.2]), np.array([-2.5, 0, 1.2]), np.eye(3))])
    assert not found.in_distribution.any()
    assert (np.abs(found.counts[0] - estimator.mean) < 0.05 * estimator.deviation).all()


def test_a_grasp_does_not_depend_on_those_beside_it(estimator) -> None:
    cloud = SAMPLES[7].cloud
    grasps = [sample.grasp for sample in SAMPLES]
    together = estimator.estimate(cloud, grasps).counts
    assert_array_equal(together, np.concatenate([estimator.estimate(cloud, [one]).counts for one in grasps]))
    assert_array_equal(estimator.estimate(cloud, grasps[::-1]).counts[::-1], together)
    assert len(np.unique(together[:, 0])) > 10  # it looks at the grasp


def test_no_grasp_gives_nothing_and_no_cloud_is_refused(estimator) -> None:
    none = estimator.estimate(SAMPLES[0].cloud, [])
    assert (none.counts.shape, none.in_distribution.shape) == ((0, 50), (0,))
    with pytest.raises(CloudError, match="0 finite points are fewer than 8"):
        estimator.estimate(Cloud(np.full((20, 3), np.nan, np.float32)), [SAMPLES[0].grasp])


def test_tensors_give_it_back_to_the_bit(estimator) -> None:
    again = ContactEstimator.from_tensors(estimator.to_tensors(), P1_RANGES)
    for one in SAMPLES[::9]:
        assert_array_equal(
            again.estimate(one.cloud, [one.grasp]).counts, estimator.estimate(one.cloud, [one.grasp]).counts
        )
    assert again.ranges is P1_RANGES


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("mean", None, "^mean: is missing"),
        ("deviation", np.ones(49), "^deviation: .* of another shape"),
        ("mean", np.full(50, np.nan), "^mean: .* not finite"),
        ("forest_E_TH/leaf", None, "^forest_E_TH/leaf: is missing"),
        ("forest_together/value", lambda a: a[:, :49], "^forest_together: does not fit 88 features and 50 values"),
        (
            "forest_PDC_MF/feature",
            lambda a: np.where(a >= 0, 88, a).astype(np.int16),
            "^forest_PDC_MF: does not fit 88",
        ),
        ("kernel/known", None, "^kernel/known: is missing"),
        ("kernel/weight", lambda a: a[:, :49], "^kernel: does not fit 88 features and 50 values"),
        ("novelty/span", np.array([1.0, 0.0]), "^novelty/known, span: "),
    ],
)
def test_damage_is_refused_by_part_and_name(estimator, name: str, value: Any, rule: str) -> None:
    tensors = estimator.to_tensors()
    if value is None:
        del tensors[name]
    else:
        tensors[name] = value(tensors[name]) if callable(value) else value
    with pytest.raises(ModelError, match=rule):
        ContactEstimator.from_tensors(tensors, P2_RANGES)
