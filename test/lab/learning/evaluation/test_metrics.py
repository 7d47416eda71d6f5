# SPDX-License-Identifier: Apache-2.0
"""Metrics against scikit-learn; bootstrap over objects by hand, against enumeration, and its coverage."""

import numpy as np
import pytest
from every_case import every_refusal
from numpy.testing import assert_allclose
from sklearn.metrics import r2_score, root_mean_squared_error

from foretouch.errors import DatasetError
from foretouch.tactile import BIOTAC, MODALITIES, P2_RANGES
from foretouch_lab.learning.evaluation.metrics import (
    MEAN,
    BootstrapConfig,
    ObjectErrors,
    ScoreEstimate,
    compare,
    mean_skill,
    score,
    skills,
)


def errors(own, reference=None, counts=None) -> ObjectErrors:
    """One number an object, the same for all 50 values."""
    own = np.asarray(own, np.float64)
    reference = np.ones(len(own)) if reference is None else np.asarray(reference, np.float64)
    counts = np.ones(len(own)) if counts is None else np.asarray(counts, np.float64)
    names = tuple(f"o{k}" for k in range(len(own)))
    return ObjectErrors(names, counts, np.tile(own[:, None], (1, 50)), np.tile(reference[:, None], (1, 50)), BIOTAC)


def test_skill_and_rmse_by_hand() -> None:
    both = errors([100.0, 300.0], [400.0, 400.0], [1, 3])
    assert skills(both)["PDC_TH"].value == pytest.approx(1 - 400 / 800)
    assert both.rmse()["E_MF"] == pytest.approx(np.sqrt(400 / 4))
    assert skills(both.only("o1"))[MEAN].value == pytest.approx(0.25)


def test_pools_as_the_metrics_do_and_those_agree_with_scikit_learn(rng) -> None:
    actual, predicted = (rng.normal(2500.0, 100.0, (30, 50)) for _ in range(2))
    mean = np.tile(actual.mean(axis=0), (30, 1))
    names = np.array(["a", "b", "c"])[rng.integers(0, 3, 30)]
    squared, reference = (predicted - actual) ** 2, (mean - actual) ** 2
    rows = [
        {"object": str(names[k]), "count": 1, "squared": squared[k], "reference": reference[k]}
        for k in rng.permutation(30)
    ]
    ours, theirs = skills(ObjectErrors.of_rows(rows, BIOTAC)), score(predicted, actual, mean, P2_RANGES.ranges)
    assert_allclose([ours[name].value for name in MODALITIES], [theirs[name]["skill"] for name in MODALITIES])
    assert ours[MEAN].value == pytest.approx(mean_skill(theirs))
    assert ObjectErrors.of_rows(rows, BIOTAC).rmse()["E_TH"] == pytest.approx(theirs["E_TH"]["rmse"])
    for name in MODALITIES:
        column = BIOTAC.columns([name])
        assert theirs[name]["skill"] == pytest.approx(r2_score(actual[:, column], predicted[:, column]))
        pooled = root_mean_squared_error(actual[:, column].ravel(), predicted[:, column].ravel())
        assert theirs[name]["rmse"] == pytest.approx(pooled)
        assert theirs[name]["nrmse"] == pytest.approx(pooled / np.ptp(P2_RANGES.ranges.of(name)))


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    config, hits = BootstrapConfig(draws=1000), 0
    for _ in range(400):
        found = skills(errors(rng.normal(1.0, 0.1, 8)), config)["PDC_TH"]
        hits += found.low <= 0.0 <= found.high
    assert 0.92 <= hits / 400 <= 0.98  # plain percentiles: 0.89


def test_what_is_hard_for_both_counts_for_neither() -> None:
    hard = np.array([1.0, 5.0, 0.2, 3.0, 0.7, 2.0, 8.0])
    pair = errors(hard * 0.9), errors(hard)
    alone = skills(pair[0])["PDC_TH"]
    assert alone.low < 0.0 < alone.high or alone.high < 0.0
    assert compare(*pair)["PDC_TH"].verdict == "better"
    assert compare(*reversed(pair))["PDC_TH"].verdict == "worse"
    assert compare(pair[0], pair[0])[MEAN].verdict == "tie"
    forth, back = compare(*pair)["E_TH"], compare(*reversed(pair))["E_TH"]
    assert_allclose([forth.value, forth.low, forth.high], [-back.value, -back.high, -back.low])


def test_same_seed_same_interval_units_do_not_matter_and_few_objects_have_none() -> None:
    one = errors([0.2, 0.5, 0.9, 1.1, 0.4, 0.7])
    assert skills(one) == skills(one)
    scaled = ObjectErrors(one.objects, one.counts, 100.0 * one.squared, 100.0 * one.reference, BIOTAC)
    assert_allclose(skills(scaled)["E_MF"].low, skills(one)["E_MF"].low)

    few = errors([0.5] * 5)  # promise nothing
    assert skills(few)["PDC_TH"] == ScoreEstimate(0.5, None, None)
    assert compare(few, errors([0.9] * 5))["PDC_TH"].verdict == "too few objects"


def test_bad_input_is_named() -> None:
    cases = (
        ("no object", lambda: ObjectErrors.of_rows([], BIOTAC)),
        ("the training mean is exact", lambda: skills(errors([1.0] * 6, [0.0] * 6))),
        ("not tested on the same grasps", lambda: compare(errors([1.0] * 6), errors([1.0] * 6, [2.0] * 6))),
        ("a value is not finite", lambda: score(np.full((30, 50), np.nan), *np.ones((2, 30, 50)), P2_RANGES.ranges)),
    )
    every_refusal(DatasetError, cases, lambda call: call())
