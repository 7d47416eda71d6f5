# SPDX-License-Identifier: Apache-2.0
"""Splits: every sample tested once, nothing leaks, seeds repeat."""

import numpy as np
from every_case import every_refusal

from foretouch.errors import DatasetError
from foretouch_lab.learning.data.folds import Fold, group_folds, random_folds, time_folds

OBJECTS = ["a"] * 7 + ["b"] * 5 + ["c"] * 6


def assert_partition(folds: list[Fold], count: int) -> None:
    assert sorted(np.concatenate([fold.test for fold in folds])) == list(range(count))
    for fold in folds:
        assert sorted([*fold.train, *fold.test]) == list(range(count))


def test_random_and_time_folds_partition_evenly_and_repeat_or_are_consecutive(rng) -> None:
    folds = random_folds(18, 5, np.random.default_rng(3))
    assert_partition(folds, 18)
    assert {len(fold.test) for fold in folds} == {3, 4}
    again = random_folds(18, 5, np.random.default_rng(3))
    assert all(np.array_equal(a.test, b.test) for a, b in zip(folds, again, strict=True))
    other = random_folds(18, 5, np.random.default_rng(4))
    assert any(not np.array_equal(a.test, b.test) for a, b in zip(folds, other, strict=True))
    stamps = rng.permutation(18)
    folds = time_folds(OBJECTS, stamps.tolist(), 5)
    assert_partition(folds, 18)
    names = np.array(OBJECTS)
    for fold in folds:
        for name in "abc":
            test = np.sort(stamps[fold.test[names[fold.test] == name]])
            train = stamps[fold.train[names[fold.train] == name]]
            assert test.size > 0
            assert not np.any((train > test[0]) & (train < test[-1]))


def test_grouped_folds_keep_objects_whole() -> None:
    folds = group_folds(OBJECTS)
    assert_partition(folds, 18)
    assert [fold.name for fold in folds] == ["a", "b", "c"]
    assert [len(fold.test) for fold in folds] == [7, 5, 6]
    folds = group_folds(OBJECTS, 2, np.random.default_rng(0))
    assert_partition(folds, 18)
    names = np.array(OBJECTS)
    for fold in folds:
        assert not set(names[fold.train]) & set(names[fold.test])


def test_impossible_splits_are_named(rng) -> None:
    cases = (
        ("4 samples are fewer than 5 folds", lambda: random_folds(4, 5, rng)),
        ("folds: 1 is fewer than 2", lambda: random_folds(4, 1, rng)),
        ("5 samples of b are fewer than 6 folds", lambda: time_folds(OBJECTS, list(range(18)), 6)),
        ("folds: all samples are of a; to keep groups apart takes 2", lambda: group_folds(["a"] * 4)),
        ("needs an rng", lambda: group_folds(OBJECTS, 2)),
    )
    every_refusal(DatasetError, cases, lambda call: call())
