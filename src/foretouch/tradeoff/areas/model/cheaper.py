# SPDX-License-Identifier: Apache-2.0
"""Cheaper forms of a fitted contact model, which need no training."""

from dataclasses import replace

from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.contact.regressors import Forest


def fewer_trees(estimator: ContactEstimator, count: int) -> ContactEstimator:
    """The same model with the first trees of each forest alone: as if it had been fitted with so many."""
    forests = {name: first_trees(forest, count) for name, forest in estimator.forests.items()}
    return replace(estimator, forests=forests)


def first_trees(forest: Forest, count: int) -> Forest:
    """The first trees of a forest, with their nodes and values alone."""
    if count >= len(forest.roots):
        return forest
    nodes = int(forest.roots[count])
    leaves = int(forest.leaf[:nodes].max()) + 1
    return Forest(
        forest.roots[:count],
        forest.feature[:nodes],
        forest.threshold[:nodes],
        forest.children[:nodes],
        forest.leaf[:nodes],
        forest.value[:leaves],
    )
