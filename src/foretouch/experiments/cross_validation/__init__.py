# SPDX-License-Identifier: Apache-2.0
"""Test predictors in P1's five random folds over all objects.

This is the easiest split: neighbours in time are in training and in test, so object, session and drift are known.
"""

from foretouch.experiments.shared.folds import split_experiment

__all__ = ["EXPERIMENT"]

EXPERIMENT = split_experiment(
    name="cross_validation",
    question="How accurate are predictions for other grasps of the same sessions?",
    module=__name__,
    split="random",
    order=10,
)
