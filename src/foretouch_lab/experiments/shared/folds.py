# SPDX-License-Identifier: Apache-2.0
"""Divide samples by fold and by object, and draw some of them for training or for touches."""

import zlib
from collections.abc import Sequence

import numpy as np

from foretouch.errors import DatasetError
from foretouch.types import GraspSample
from foretouch_lab.learning.data.folds import Fold, Indices


def split_by_fold(
    samples: Sequence[GraspSample], folds: Sequence[Fold], name: str
) -> tuple[list[GraspSample], list[GraspSample]]:
    """Training and test samples of the fold of a name."""
    (fold,) = (one for one in folds if one.name == name)
    return [samples[k] for k in fold.train], [samples[k] for k in fold.test]


def split_objects(
    samples: Sequence[GraspSample], train_objects: int, seed: int
) -> tuple[list[GraspSample], list[GraspSample]]:
    """Samples of `train_objects` randomly drawn objects, and those of the others; `DatasetError` if none is left."""
    names = sorted({sample.object for sample in samples})
    if train_objects >= len(names):
        raise DatasetError(f"split: of {len(names)} objects, {train_objects} for training leave none to test on")
    chosen = {names[k] for k in np.random.default_rng(seed).permutation(len(names))[:train_objects]}
    return [one for one in samples if one.object in chosen], [one for one in samples if one.object not in chosen]


def by_object(samples: Sequence[GraspSample]) -> list[list[GraspSample]]:
    """Samples of each object, objects sorted by name."""
    names = sorted({sample.object for sample in samples})
    return [[sample for sample in samples if sample.object == name] for name in names]


def some_grasps(samples: Sequence[GraspSample], count: int, seed: int) -> list[GraspSample]:
    """Draw `count` grasps of each object; a smaller draw is part of a larger one. `DatasetError` if one has fewer."""
    groups = by_object(samples)
    if few := [own for own in groups if len(own) < count]:
        raise DatasetError(f"training grasps: {few[0][0].object} has {len(few[0])} grasps, fewer than {count}")
    return [own[k] for own in groups for k in _shuffled(own[0].object, seed, len(own))[:count]]


def some_objects(samples: Sequence[GraspSample], count: int, seed: int) -> list[GraspSample]:
    """All grasps of `count` drawn objects; a smaller draw is part of a larger one. `DatasetError` if there are fewer."""
    groups = by_object(samples)
    if len(groups) < count:
        raise DatasetError(f"training objects: {len(groups)} objects are fewer than {count}")
    return [sample for k in np.random.default_rng(seed).permutation(len(groups))[:count] for sample in groups[k]]


def touch_draws(name: str, count: int, most: int, draws: int) -> list[Indices]:
    """For each draw, all grasps of an object in the order in which they would be touched.

    The draws follow from the name, the number of grasps and their own number alone: they are the same for every
    predictor, and 3 touches are the first of the 5. Raises `DatasetError` if no grasp would be left after `most`.
    """
    if count <= most:
        raise DatasetError(f"{name}: {count} grasps leave none to score after {most} touches")
    return [_shuffled(name, draw, count) for draw in range(draws)]


def _shuffled(name: str, number: int, count: int) -> Indices:
    return np.random.default_rng([zlib.crc32(name.encode()), number]).permutation(count)
