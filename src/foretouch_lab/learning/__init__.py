# SPDX-License-Identifier: Apache-2.0
"""Training and evaluation of touch models.

    data        datasets, splits, folds, inputs prepared for a network
    training    trainers and losses; calibration; learners (one per method); run: settings and a dataset to a model folder
    evaluation  metrics, baselines, comparisons; evaluation of models and cross-validation of methods

`data` and the metrics, baselines and comparisons do not import torch.
"""
