# SPDX-License-Identifier: Apache-2.0
"""Samples to train and evaluate on: datasets, splits, folds, and inputs prepared for a network; free of torch."""

from foretouch_lab.learning.data.dataset import Dataset, load_dataset
from foretouch_lab.learning.data.folds import make_folds
from foretouch_lab.learning.data.training_set import channels_of, labels_of

__all__ = ["Dataset", "channels_of", "labels_of", "load_dataset", "make_folds"]
