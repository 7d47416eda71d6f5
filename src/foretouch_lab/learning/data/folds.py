# SPDX-License-Identifier: Apache-2.0
"""Cross-validation folds: each sample is predicted once, by a model that was fitted without it.

Three splits answer three questions:

- `random`: how well is another grasp of the same recording sessions predicted? P1's five folds. Neighbours in
  time are in training and test, so the model has seen drift and session: the easiest question.
- `time`: how well is a later (or earlier) grasp of the same objects predicted? Each object's recording is
  cut into consecutive blocks.
- `object`: how well is a new object predicted? In the public recordings this is also another day, since each
  object was recorded on different days.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from foretouch.base.processes import process_pool
from foretouch.errors import ConfigError, DatasetError, none_of, quoted
from foretouch.types import Float64, Index, Sample
from foretouch_lab.dataset.store_writer import SampleFacts

SPLITS: Final = ("random", "time", "object")
"""Random five folds, five blocks of time within each object, and one object left out."""

FOLDS: Final = 5
_MOST_OBJECT_FOLDS: Final = 10

Indices: TypeAlias = Index
"""(S,) indices of samples."""


@dataclass(frozen=True, eq=False)
class Fold:
    """One partition of the samples."""

    train: Indices  # samples to learn from with their labels, sorted
    test: Indices  # samples to evaluate on, none of those to learn from; empty where no split is configured
    name: str = ""  # name of the test side
    unlabelled: Indices = field(default_factory=lambda: np.empty(0, np.intp))  # samples to learn from without labels

    def sides(self, samples: Sequence[Sample]) -> tuple[list[Sample], list[Sample]]:
        """Return the samples to learn from with their labels, and those to evaluate on."""
        return [samples[k] for k in self.train], [samples[k] for k in self.test]


HoldOut = Callable[[Fold], Float64]
"""Fits to the training side of a fold and returns (T, D) predictions of its test side [counts]."""


def predict_folds(jobs: Mapping[str, tuple[HoldOut, Sequence[Fold]]], workers: int = 1) -> dict[str, Float64]:
    """Return (S, D) held-out predictions by name: each sample's is from the one fold that tests it [counts].

    With several workers, folds run in processes of one thread each; the results are the same.

    Args:
        jobs: By name, what predicts a fold, and the folds, which test each sample once.
        workers: Number of processes.

    Raises:
        ConfigError: If the number of processes is none.
    """
    _require_whole(workers, "workers", 1)
    parts = zip(*[(predict, fold) for predict, folds in jobs.values() for fold in folds], strict=True)
    with process_pool(workers) if workers > 1 else nullcontext() as pool:
        predicted = iter(list(map(_predict, *parts) if pool is None else pool.map(_predict, *parts)))
    result = {}
    for name, (_, folds) in jobs.items():
        rows = np.concatenate(list(islice(predicted, len(folds))))
        result[name] = np.empty_like(rows)
        result[name][np.concatenate([fold.test for fold in folds])] = rows
    return result


def _require_whole(value: Any, name: str, least: int) -> None:
    """Refuse what is no whole number from the least one on."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ConfigError(f"{name}: {quoted(value)} is not a whole number from {least}")


def _predict(predict: HoldOut, fold: Fold) -> Float64:
    return predict(fold)


def make_folds(samples: Sequence[Sample | SampleFacts], split: str, seed: int | np.random.Generator) -> list[Fold]:
    """Return the folds of one of `SPLITS`; the random split uses the seed.

    Args:
        samples: The samples.
        split: One of `SPLITS`.
        seed: Of the random split.

    Raises:
        ConfigError: If the seed is no whole number from 0.
        DatasetError: If there is no such split, or there are too few samples for it.
    """
    if not isinstance(seed, np.random.Generator | None):
        _require_whole(seed, "seed", 0)
    objects = np.array([sample.object for sample in samples], np.str_)
    if split == "object":
        return group_folds(objects)
    if split not in SPLITS:
        raise DatasetError(f"split: {none_of(split, SPLITS)}")
    names, counts = np.unique(objects, return_counts=True)
    least = {"": len(objects)} if split == "random" else dict(zip(names.tolist(), counts.tolist(), strict=True))
    for name, count in least.items():
        if count < FOLDS:
            raise DatasetError(f"folds: {count} samples{f' of {name}' if name else ''} are fewer than {FOLDS} folds")
    if split == "random":  # shuffled samples, in parts whose sizes differ by at most one
        tests = np.array_split(np.random.default_rng(seed).permutation(len(objects)), FOLDS)
        return _folds(len(objects), tests, [f"random {k}" for k in range(FOLDS)])
    # Consecutive blocks of each object's recording; fold k tests the block k of every object.
    order = np.argsort([sample.stamp_ns for sample in samples], kind="stable")
    recordings = [np.array_split(order[objects[order] == name], FOLDS) for name in names]
    blocks = [np.concatenate(block) for block in zip(*recordings, strict=True)]
    return _folds(len(objects), blocks, [f"block {k}" for k in range(FOLDS)])


def group_folds(
    groups: Sequence[str] | npt.NDArray[np.str_], folds: int | None = None, rng: np.random.Generator | None = None
) -> list[Fold]:
    """Keep each group on one side.

    Args:
        groups: (S,) name of each sample's group: its object.
        folds: Number of folds among which the shuffled groups are distributed; by default one fold per group, in
            order of name (leave one object out).
        rng: Shuffles the groups; required with `folds`.

    Raises:
        DatasetError: If there is only one group.
    """
    groups = np.asarray(groups, np.str_)
    names = np.unique(groups)
    if len(names) < 2:
        raise DatasetError(f"folds: all samples are of {names[0]}; to keep groups apart takes 2")
    parts = [[name] for name in names]
    if folds is not None and rng is not None:
        shuffled = rng.permutation(len(names))
        parts = [list(names[shuffled[k::folds]]) for k in range(folds)]
    tests = [np.concatenate([np.flatnonzero(groups == name) for name in part]) for part in parts]
    return _folds(len(groups), tests, ["+".join(sorted(part)) for part in parts])


def object_folds(objects: Sequence[str]) -> list[Fold]:
    """Leave one object out at a time, or a tenth where there are more than ten; at least two are required."""
    if len(set(objects)) <= _MOST_OBJECT_FOLDS:
        return group_folds(objects)
    return group_folds(objects, _MOST_OBJECT_FOLDS, np.random.default_rng(0))


def _folds(count: int, tests: Sequence[Indices], names: Sequence[str]) -> list[Fold]:
    everything = np.arange(count, dtype=np.intp)
    return [
        Fold(train=np.setdiff1d(everything, test), test=np.sort(test).astype(np.intp), name=name)
        for test, name in zip(tests, names, strict=True)
    ]
