# SPDX-License-Identifier: Apache-2.0
"""Kernel ridge regression: scikit-learn's answers, the mean far away, neighbours without influence."""

from typing import Any

import numpy as np
import pytest
from every_case import every_case
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.kernel_ridge import KernelRidge
from sklearn.metrics.pairwise import laplacian_kernel

from foretouch.errors import ModelError
from foretouch.models.contact.regressors import KernelRegression, laplacian
from foretouch.models.novelty import standardisation

DECAY, RIDGE = 2.0, 0.7


@pytest.fixture
def rows(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(60, 7)) * [1e-3, 0.1, 1.0, 10.0, 1.0, 1.0, 300.0] + 5.0


@pytest.fixture
def target(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(60, 3))


@pytest.fixture
def kernel(rows, target) -> KernelRegression:
    centre, scale = standardisation(rows)
    known = (rows - centre) / scale
    weight = np.linalg.solve(laplacian(known, known, DECAY) + RIDGE * np.eye(60), target)
    return KernelRegression(centre, scale, known.astype(np.float32), weight.astype(np.float32), np.array(DECAY))


def test_kernel_and_predictions_are_scikit_learns_and_constant_columns_are_found(kernel, rows, target, rng) -> None:
    a, b = rng.normal(size=(5, 7)), rng.normal(size=(4, 7))
    assert_allclose(laplacian(a, b, DECAY), laplacian_kernel(a, b, gamma=DECAY / 7), rtol=1e-12)
    asked = rows.mean(axis=0) + 1.5 * rows.std(axis=0) * rng.normal(size=(40, 7))
    theirs = KernelRidge(alpha=RIDGE, kernel="laplacian", gamma=DECAY / 7)
    theirs.fit((rows - kernel.centre) / kernel.scale, target)
    wanted = theirs.predict((asked - kernel.centre) / kernel.scale)
    # Known rows and weights are rounded to float32, 6e-8 each, and 60 of them are summed.
    assert_allclose(kernel.predict(asked), wanted, atol=1e-5)
    assert np.abs(wanted).max() > 0.1
    # The mean of sixty times 0.05 is not 0.05, so the deviation is 2e-17 and not 0.
    rows = np.column_stack([np.full(60, 0.05), np.arange(60.0)])
    assert rows.std(axis=0)[0] > 0.0
    centre, scale = standardisation(rows)
    assert scale[0] == 1.0
    assert abs((0.051 - centre[0]) / scale[0]) < 0.01
    assert scale[1] == rows[:, 1].std()


def test_far_from_all_that_is_known_it_has_no_opinion_and_rows_do_not_depend_on_each_other(kernel, rows) -> None:
    far = rows[:1] + rows.std(axis=0) * np.array([[0.0], [2.0], [10.0], [100.0]])
    size = np.abs(kernel.predict(far)).max(axis=1)
    assert (np.diff(size) < 0.0).all()
    assert size[3] < 1e-30  # every column 100 deviations off: exp(-2 · 100) or so
    together = kernel.predict(rows)
    assert_array_equal(together, np.concatenate([kernel.predict(row[None]) for row in rows]))
    assert_array_equal(kernel.predict(rows[::-1])[::-1], together)
    assert kernel.predict(rows[:0]).shape == (0, 3)


def test_damage_is_refused_by_name(kernel, rows) -> None:
    tensors = kernel.to_tensors()
    assert_array_equal(KernelRegression.from_tensors(tensors).predict(rows), kernel.predict(rows))

    def check(rule: str, name: str, value: Any) -> None:
        with pytest.raises(ModelError, match=rule):
            KernelRegression.from_tensors({**tensors, name: value})

    cases = [
        ("known: .* not within", "known", np.full((60, 7), np.nan, np.float32)),
        ("known: shape", "known", np.zeros((60, 6), np.float32)),
        ("weight: shape", "weight", np.zeros((59, 3), np.float32)),
        ("centre: shape", "centre", np.zeros((1, 7))),
        ("decay: shape", "decay", np.ones(1)),
        ("scale: .* not within", "scale", np.array([1.0, 1, 1, 0, 1, 1, 1])),
        ("decay: .* not within", "decay", np.array(-2.0)),
    ]
    every_case(cases, check)
    del tensors["weight"]
    check("weight: is missing", "known", tensors["known"])
