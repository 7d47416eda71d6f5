# SPDX-License-Identifier: Apache-2.0
"""Samples to train and evaluate on: collections, splits and folds."""
