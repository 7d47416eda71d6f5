# SPDX-License-Identifier: Apache-2.0
"""Test predictors in five consecutive blocks of time within each object.

The folds do not depend on the seed, which only changes the predictors.
"""

from foretouch.experiments.shared.folds import split_experiment

__all__ = ["EXPERIMENT"]

EXPERIMENT = split_experiment(
    name="time_blocked",
    question="How accurate are predictions for earlier or later grasps of the same objects?",
    module=__name__,
    split="time",
    order=20,
)
