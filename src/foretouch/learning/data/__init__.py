# SPDX-License-Identifier: Apache-2.0
"""Samples to train and evaluate on: datasets, splits, folds, and inputs prepared for a network; free of torch."""

from foretouch.learning.data.dataset import Dataset, DataSplit, load_dataset
from foretouch.learning.data.folds import (
    SPLITS,
    Fold,
    HoldOut,
    Indices,
    fold_workers,
    group_folds,
    make_folds,
    object_folds,
    predict_folds,
    random_folds,
    time_folds,
)
from foretouch.learning.data.splits import SplitPart
from foretouch.learning.data.training_set import TrainingSet, duplicate_labels, labels_of, predict_set

__all__ = [
    "SPLITS",
    "DataSplit",
    "Dataset",
    "Fold",
    "HoldOut",
    "Indices",
    "SplitPart",
    "TrainingSet",
    "duplicate_labels",
    "fold_workers",
    "group_folds",
    "labels_of",
    "load_dataset",
    "make_folds",
    "object_folds",
    "predict_folds",
    "predict_set",
    "random_folds",
    "time_folds",
]
