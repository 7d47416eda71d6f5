# SPDX-License-Identifier: Apache-2.0
"""The contact model in the hand's frame: its claim on new objects, and what it calls unfamiliar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, hand_estimator, labels_of, moved, small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from foretouch.errors import ModelError
from foretouch.learning.training.contact import ContactPredictor, describe_samples, fit_contact, thinned_samples
from foretouch.models.contact.estimator import ContactEstimator, by_modality
from foretouch.models.contact.hand_features import CHECKED, CONDITIONS, HandScene
from foretouch.models.contact.hand_novelty import HandNoveltyDetector
from foretouch.tactile import MODALITIES, P1_RANGES, columns
from foretouch.types import Cloud

SAMPLES = make_samples(5, 10)


@pytest.fixture
def estimator() -> ContactEstimator:
    return hand_estimator()


def outside(estimator: ContactEstimator) -> ContactEstimator:
    """The same, to which nothing is familiar."""
    return replace(estimator, novelty=replace(estimator.novelty, span=np.array([-2.0, -1.0])))


@pytest.mark.parametrize("claim", [[0.0, 0.0, 0.0, 0.0], [0.25, 0.5, 0.0, 1.0]])
def test_a_new_object_gets_the_share_of_the_kernel_that_is_claimed(estimator, claim: list[float]) -> None:
    one = SAMPLES[3]
    model = replace(outside(estimator), claim=np.array(claim))
    found = model.estimate(one.cloud, [one.grasp])
    rows = HandScene(one.cloud.xyz).describe([one.grasp])
    whole = estimator.kernel.predict(rows[:, len(CONDITIONS) :]) * estimator.deviation
    assert_allclose(found.counts - estimator.mean, by_modality(np.array(claim)) * whole, atol=1e-9)
    assert not found.in_distribution.any()


def test_tensors_give_it_back_to_the_bit(estimator) -> None:
    again = ContactEstimator.from_tensors(estimator.to_tensors(), P1_RANGES)
    assert_array_equal(again.claim, estimator.claim)
    for one in SAMPLES[::9]:
        before, after = (which.estimate(one.cloud, [one.grasp]) for which in (estimator, again))
        assert_array_equal(after.counts, before.counts)
        assert_array_equal(after.in_distribution, before.in_distribution)


def test_files_without_a_claim_are_of_the_first_kind() -> None:
    """contact-v1 and models that were trained as it."""
    tensors = small_estimator().to_tensors()
    assert "claim" not in tensors
    assert ContactEstimator.from_tensors(tensors, P1_RANGES).claim is None


@pytest.mark.parametrize("value", [np.full(3, 0.5), np.full(4, 1.5), np.full(4, np.nan)])
def test_a_claim_that_is_no_share_is_refused(estimator, value: np.ndarray) -> None:
    with pytest.raises(ModelError, match=r"^claim: shape \(\d,\) is not \(4,\), or a value is not in \[0, 1\]"):
        ContactEstimator.from_tensors({**estimator.to_tensors(), "claim": value}, P1_RANGES)


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("forest_together/value", lambda a: a[:, :49], "^forest_together: does not fit 56 features and 50 values"),
        ("kernel/weight", lambda a: a[:, :49], "^kernel: does not fit 56 features and 50 values"),
        ("novelty/low", lambda a: a[:3], r"^novelty/low: shape \(3,\) is not \(5,\)"),
        ("novelty/high", lambda a: a * np.nan, "^novelty/high: .* not finite"),
    ],
)
def test_damage_is_refused_by_part_and_name(estimator, name: str, value, rule: str) -> None:
    tensors = estimator.to_tensors()
    tensors[name] = value(tensors[name])
    with pytest.raises(ModelError, match=rule):
        ContactEstimator.from_tensors(tensors, P1_RANGES)


def test_grasps_of_one_call_do_not_depend_on_each_other(estimator) -> None:
    cloud, grasps = SAMPLES[7].cloud, [sample.grasp for sample in SAMPLES]
    together = estimator.estimate(cloud, grasps).counts
    assert_array_equal(together, np.concatenate([estimator.estimate(cloud, [one]).counts for one in grasps]))
    assert len(np.unique(together[:, 0])) > 10  # it looks at the grasp


@pytest.mark.parametrize("degrees", [90.0, 180.0])
def test_a_roll_and_a_shift_change_neither_prediction_nor_flag(estimator, degrees: float) -> None:
    R, shift = Rotation.from_euler("z", degrees, degrees=True).as_matrix(), np.array([0.02, 0.05, -0.1])
    for one in SAMPLES[::5]:
        before = estimator.estimate(one.cloud, [one.grasp])
        cloud = Cloud((one.cloud.xyz.reshape(-1, 3).astype(np.float64) @ R.T + shift).astype(np.float32))
        after = estimator.estimate(cloud, [moved(one.grasp, R, shift)])
        assert_allclose(after.counts, before.counts, atol=0.5 * estimator.deviation.max())  # float32 may turn a split
        assert np.median(np.abs(after.counts - before.counts)) < 1e-3
        assert_array_equal(after.in_distribution, before.in_distribution)


def turned_by(degrees: float, one) -> tuple[Cloud, list]:
    """Cloud and grasp, seen by a camera that is tilted against them."""
    R = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    centre = np.asarray(one.cloud.xyz.reshape(-1, 3).mean(axis=0), np.float64)
    shift = centre - R @ centre
    xyz = (one.cloud.xyz.reshape(-1, 3).astype(np.float64) @ R.T + shift).astype(np.float32)
    return Cloud(xyz), [moved(one.grasp, R, shift)]


def test_what_training_never_covered_is_unfamiliar(estimator) -> None:
    flagged = {"half the range": 0, "far away": 0, "few points": 0, "another approach": 0, "as trained": 0}
    for one in SAMPLES[::5]:
        xyz = one.cloud.xyz.reshape(-1, 3)
        centre = xyz.mean(axis=0)
        places = {"half the range": -0.55 * centre, "far away": 1.5 * centre}
        for name, shift in places.items():
            grasp = moved(one.grasp, np.eye(3), shift.astype(np.float64))
            flagged[name] += not estimator.estimate(Cloud(xyz + shift), [grasp]).in_distribution[0]
        few = Cloud(xyz[np.random.default_rng(0).permutation(len(xyz))[: len(xyz) // 10]])
        flagged["few points"] += not estimator.estimate(few, [one.grasp]).in_distribution[0]
        flagged["another approach"] += not estimator.estimate(*turned_by(80.0, one)).in_distribution[0]
        flagged["as trained"] += not estimator.estimate(one.cloud, [one.grasp]).in_distribution[0]
    assert flagged.pop("as trained") <= 2
    assert set(flagged.values()) == {10}


def test_scores_of_rows_are_those_of_each(estimator) -> None:
    rows = describe_samples(SAMPLES)
    detector = HandNoveltyDetector.fit(rows, [one.object for one in SAMPLES])
    one_by_one = np.concatenate([detector.scores(row[None]) for row in rows])
    assert_array_equal(detector.scores(rows), one_by_one)
    assert detector.low[0] > 0.0  # distance
    assert CHECKED[:2] == CONDITIONS


def test_copies_of_half_the_points_are_learnt_too() -> None:
    """Forests that saw them predict nearly the same for a thinned cloud."""
    config = FEW_TREES.replace(trees=20, thinned=0.5)
    labels, objects = labels_of(SAMPLES), [one.object for one in SAMPLES]
    rows = describe_samples(SAMPLES)
    copies = thinned_samples(SAMPLES, config)
    assert copies is not None
    assert thinned_samples(SAMPLES, FEW_TREES) is None
    for copy, one in zip(copies, SAMPLES, strict=True):
        assert copy.cloud.size == round(0.5 * one.cloud.size)
    with_copies = fit_contact(rows, labels, objects, config, describe_samples(copies))
    without = fit_contact(rows, labels, objects, config)
    others = describe_samples(thinned_samples(SAMPLES, config.replace(seed=5)))
    moves = [np.abs(one.predict_rows(others)[0] - one.predict_rows(rows)[0]).mean() for one in (with_copies, without)]
    assert moves[0] < moves[1]
    predictor = ContactPredictor(SAMPLES, labels, config)
    assert_array_equal(predictor.estimator.predict_rows(rows)[0], with_copies.predict_rows(rows)[0])


def test_claims_are_by_modality() -> None:
    values = by_modality(np.array([1.0, 2.0, 3.0, 4.0]))
    for value, name in enumerate(MODALITIES, 1):
        assert (values[columns([name])] == value).all()
