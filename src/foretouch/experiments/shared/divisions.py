# SPDX-License-Identifier: Apache-2.0
"""Divisions of objects into those learned from and those that were never touched."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foretouch.errors import DatasetError
from foretouch.types import GraspSample

__all__ = ["by_object", "divide_objects"]


def divide_objects(
    samples: Sequence[GraspSample], learned: int, seed: int
) -> tuple[list[GraspSample], list[GraspSample]]:
    """Samples of `learned` objects drawn by a seed, and those of the others.

    Raises:
        DatasetError: If no object is left to be tested on.
    """
    names = sorted({sample.object for sample in samples})
    if learned >= len(names):
        raise DatasetError(f"division: of {len(names)} objects, {learned} to learn from leave none to test on")
    chosen = {names[k] for k in np.random.default_rng(seed).permutation(len(names))[:learned]}
    return (
        [sample for sample in samples if sample.object in chosen],
        [sample for sample in samples if sample.object not in chosen],
    )


def by_object(samples: Sequence[GraspSample]) -> list[list[GraspSample]]:
    """Samples of each object, objects in order of their names."""
    names = sorted({sample.object for sample in samples})
    return [[sample for sample in samples if sample.object == name] for name in names]
