# SPDX-License-Identifier: Apache-2.0
"""Which samples a run learns from, chooses its epoch by, and is judged on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foretouch.errors import DatasetError
from foretouch.learning.data.collection import Collection
from foretouch.learning.data.folds import Indices
from foretouch.learning.training.run_config import RunConfig

__all__ = ["Division", "divide"]


@dataclass(frozen=True, eq=False)
class Division:
    """Places of samples, each sample on one side at most.

    Attributes:
        train: To learn from with their labels.
        unlabelled: To learn from without.
        validation: To choose the epoch by.
        test: To be judged on; empty where no split is configured.
    """

    train: Indices
    unlabelled: Indices
    validation: Indices
    test: Indices

    def sizes(self) -> dict[str, int]:
        """Number of samples by side, for a card."""
        return {side: len(index) for side, index in vars(self).items()}


def divide(config: RunConfig, data: Collection) -> Division:
    """Divide samples as configured.

    Raises:
        DatasetError: If the split is none of the data's or has several parts, nothing is labelled, nothing is unlabelled
            where that is needed, or the validation share of the samples is none.
    """
    train = np.array([k for k, sample in enumerate(data.samples) if sample.touch is not None], np.intp)
    unlabelled = np.setdiff1d(np.arange(len(data.samples), dtype=np.intp), train)
    test = np.empty(0, np.intp)
    if config.split is not None:
        parts = data.parts(config.split)
        if len(parts) != 1:
            raise DatasetError(
                f"{data.name}: split: {config.split!r} has {len(parts)} parts; choose one: {config.split}/{parts[0].name}"
            )
        train, test, unlabelled = (data.index(ids) for ids in (parts[0].train, parts[0].test, parts[0].unlabelled))
    if config.method == "srgan" and not len(unlabelled):
        raise DatasetError(
            f"{data.name}: srgan: no sample is unlabelled; choose a split that withholds labels, such as labels/T50"
        )
    if not len(train):
        raise DatasetError(f"{data.name}: no sample to learn from is labelled")
    held = np.random.default_rng(config.seed).permutation(train)[: round(config.validation * len(train))]
    if config.validation > 0.0 and not len(held):
        raise DatasetError(f"{data.name}: validation: {config.validation} of {len(train)} samples is none")
    return Division(np.setdiff1d(train, held), unlabelled, np.sort(held), test)
