# SPDX-License-Identifier: Apache-2.0
"""Forests as arrays: scikit-learn's own predictions, and damage refused by name."""

from typing import Any

import numpy as np
import pytest
from every_case import every_case
from numpy.testing import assert_allclose
from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor

from foretouch.errors import ModelError
from foretouch.models.contact.regressors import Forest

HALF = 2.0**-11
"""Relative rounding of float16."""


def fitted(outputs: int, kind: Any = ExtraTreesRegressor, seed: int = 0) -> tuple[Any, np.ndarray]:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(200, 6))
    target = np.sin(rows[:, :1] * np.arange(1, outputs + 1)) + rows[:, 1:2] + 0.1 * rng.normal(size=(200, outputs))
    target = (target - target.mean(axis=0)) / target.std(axis=0)
    model = kind(20, min_samples_leaf=3, random_state=seed).fit(rows, target if outputs > 1 else target[:, 0])
    return model, rows


def forest_of(model: Any) -> Forest:
    return Forest.from_trees([tree.tree_ for tree in model.estimators_])


def test_every_row_and_one_on_a_threshold_reaches_scikit_learn_s_leaf(rng) -> None:
    """Also of a stump of one leaf."""
    stump = ExtraTreesRegressor(2, min_samples_leaf=50, random_state=0).fit(np.eye(60), np.arange(60.0))
    for model in (fitted(1)[0], fitted(3)[0], stump):
        asked = 2.0 * rng.normal(size=(300, model.n_features_in_))
        leaves = model.apply(asked)
        values = [tree.tree_.value[leaves[:, k], :, 0].astype(np.float16) for k, tree in enumerate(model.estimators_)]
        assert_allclose(forest_of(model).predict(asked), np.mean(values, axis=0, dtype=np.float64), atol=1e-14)
    model, rows = fitted(1, RandomForestRegressor)
    tree = model.estimators_[0].tree_
    inner = np.flatnonzero(tree.feature >= 0)
    asked = rows[: len(inner)].copy()
    asked[np.arange(len(inner)), tree.feature[inner]] = tree.threshold[inner]
    largest = np.abs(tree.value).max()
    found = Forest.from_trees([tree]).predict(asked)[:, 0]
    assert_allclose(found, model.estimators_[0].predict(asked), atol=HALF * largest)


def test_damage_is_refused_by_name() -> None:
    whole = forest_of(fitted(2)[0]).to_tensors()
    node, leaf = np.flatnonzero(whole["feature"] >= 0)[3], np.flatnonzero(whole["feature"] < 0)[0]

    def put(name: str, index: Any, value: float) -> dict[str, np.ndarray]:
        array = whole[name].copy()
        array[index] = value
        return {name: array}

    def check(rule: str, change: dict[str, np.ndarray]) -> None:
        with pytest.raises(ModelError, match=rule):
            Forest.from_tensors({**whole, **change})

    astray = "children: an inner node leads back, or a leaf on"
    cases = [
        (astray, put("children", (node, 0), node - 1)),
        (astray, put("children", (node, 1), node)),
        ("children: .* not within", put("children", (node, 1), len(whole["feature"]))),
        (astray, put("children", leaf, leaf + 1)),
        *(("leaf: .* not within", put("leaf", k, value)) for k, value in ((0, -1), (-1, 60_000))),
        *(("roots: .* not within", put("roots", k, value)) for k, value in ((0, -1), (-1, 10**6))),
        *(("value: .* not within", put("value", (0, 0), value)) for value in (np.nan, np.inf)),
        ("threshold: .* not within", put("threshold", 0, np.nan)),
        ("there is no tree", {"roots": whole["roots"][:0]}),
        ("feature: shape", {"feature": np.array(3, np.int16)}),
        ("threshold: shape", {"threshold": whole["threshold"][:-1]}),
        ("children: shape", {"children": whole["children"][:, :1]}),
        ("value: shape", {"value": whole["value"][:, 0]}),
        ("value: dtype float32 is not float16", {"value": whole["value"].astype(np.float32)}),
    ]
    every_case(cases, check)
    del whole["leaf"]
    check("leaf: is missing", {})
