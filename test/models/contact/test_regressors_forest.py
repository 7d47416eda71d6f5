# SPDX-License-Identifier: Apache-2.0
"""Forests as arrays: scikit-learn's own predictions, and damage refused by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
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


@pytest.mark.parametrize("kind", [ExtraTreesRegressor, RandomForestRegressor])
@pytest.mark.parametrize("outputs", [1, 5])
def test_predictions_are_scikit_learn_s_but_for_the_rounding_of_leaves(outputs: int, kind: Any, rng) -> None:
    model, rows = fitted(outputs, kind)
    asked = np.concatenate([rows, 2.0 * rng.normal(size=(300, 6))])
    largest = max(np.abs(tree.tree_.value).max() for tree in model.estimators_)
    found = forest_of(model).predict(asked)
    assert found.shape == (500, outputs)
    assert_allclose(found, model.predict(asked).reshape(500, outputs), rtol=0.0, atol=HALF * largest)


def test_every_row_reaches_scikit_learn_s_leaf(rng) -> None:
    model, _ = fitted(3)
    asked = rng.normal(size=(100, 6))
    leaves = model.apply(asked)
    values = [tree.tree_.value[leaves[:, k], :, 0].astype(np.float16) for k, tree in enumerate(model.estimators_)]
    assert_allclose(forest_of(model).predict(asked), np.mean(values, axis=0, dtype=np.float64), atol=1e-14)


def test_a_row_on_a_threshold_goes_scikit_learn_s_way() -> None:
    model, rows = fitted(1, RandomForestRegressor)
    tree = model.estimators_[0].tree_
    inner = np.flatnonzero(tree.feature >= 0)
    asked = rows[: len(inner)].copy()
    asked[np.arange(len(inner)), tree.feature[inner]] = tree.threshold[inner]
    largest = np.abs(tree.value).max()
    found = Forest.from_trees([tree]).predict(asked)[:, 0]
    assert_allclose(found, model.estimators_[0].predict(asked), atol=HALF * largest)


@pytest.mark.parametrize("outputs", [1, 50])
def test_a_row_does_not_depend_on_its_neighbours(outputs: int) -> None:
    model, rows = fitted(outputs)
    forest = forest_of(model)
    together = forest.predict(rows)
    assert_array_equal(together, np.concatenate([forest.predict(row[None]) for row in rows]))
    assert_array_equal(forest.predict(rows[::-1])[::-1], together)
    assert forest.predict(np.empty((0, 6))).shape == (0, outputs)


def test_a_stump_of_one_leaf_predicts_its_mean() -> None:
    model = ExtraTreesRegressor(2, min_samples_leaf=50, random_state=0).fit(np.eye(60), np.arange(60.0))
    assert_array_equal(forest_of(model).predict(np.zeros((2, 60))), [[29.5], [29.5]])


def test_tensors_give_the_forest_back_to_the_bit() -> None:
    model, rows = fitted(5)
    forest = forest_of(model)
    again = Forest.from_tensors(forest.to_tensors())
    assert again.output_size == forest.output_size == 5
    assert_array_equal(again.predict(rows), forest.predict(rows))


def inner_node(tensors: dict[str, np.ndarray]) -> int:
    return int(np.flatnonzero(tensors["feature"] >= 0)[3])


def back(tensors: dict[str, np.ndarray]) -> None:
    node = inner_node(tensors)
    tensors["children"][node, 0] = node - 1


def circle(tensors: dict[str, np.ndarray]) -> None:
    node = inner_node(tensors)
    tensors["children"][node, 1] = node


def beyond(tensors: dict[str, np.ndarray]) -> None:
    tensors["children"][inner_node(tensors), 1] = len(tensors["feature"])


def a_leaf_goes_on(tensors: dict[str, np.ndarray]) -> None:
    tensors["children"][np.flatnonzero(tensors["feature"] < 0)[0]] += 1


def put(name: str, index: Any, value: float) -> Callable[[dict[str, np.ndarray]], None]:
    def change(tensors: dict[str, np.ndarray]) -> None:
        tensors[name][index] = value

    return change


def become(name: str, made: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, np.ndarray]], None]:
    def change(tensors: dict[str, np.ndarray]) -> None:
        tensors[name] = made(tensors[name])

    return change


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (back, "children: a node leads outside the tree, or back"),
        (circle, "children: a node leads outside the tree, or back"),
        (beyond, "children: a node leads outside the tree, or back"),
        (a_leaf_goes_on, "children: a node leads outside the tree, or back"),
        (put("leaf", 0, -1), "leaf: names no value"),
        (put("leaf", -1, 60_000), "leaf: names no value"),
        (put("roots", 0, -1), "roots, value: a root is no node"),
        (put("roots", -1, 10**6), "roots, value: a root is no node"),
        (put("value", (0, 0), np.nan), "a value is not finite"),
        (put("value", (0, 0), np.inf), "a value is not finite"),
        (put("threshold", 0, np.nan), "a threshold is not finite"),
        (become("roots", lambda x: x[:0]), "there is no tree"),
        (become("roots", lambda x: x[:, None]), "arrays do not fit together"),
        (become("feature", lambda x: x[:, None]), "arrays do not fit together"),
        (become("feature", lambda x: x[:-1]), "arrays do not fit together"),
        (become("threshold", lambda x: x[:-1]), "arrays do not fit together"),
        (become("children", lambda x: x[:, :1]), "arrays do not fit together"),
        (become("value", lambda x: x[:, 0]), "arrays do not fit together"),
        (become("feature", lambda x: np.array(3, np.int16)), "arrays do not fit together"),
        (become("children", lambda x: x.astype(np.int64)), "children: dtype int64 is not int32"),
        (become("value", lambda x: x.astype(np.float32)), "value: dtype float32 is not float16"),
        (lambda tensors: tensors.pop("leaf"), "leaf: is missing"),
    ],
)
def test_damage_is_refused_by_name(change: Callable[[dict[str, np.ndarray]], Any], rule: str) -> None:
    tensors = {name: array.copy() for name, array in forest_of(fitted(2)[0]).to_tensors().items()}
    change(tensors)
    with pytest.raises(ModelError, match=rule):
        Forest.from_tensors(tensors)
