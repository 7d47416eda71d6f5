# SPDX-License-Identifier: Apache-2.0
"""Cheaper forms of a fitted contact model, which need no training: fewer trees, or a part of the features alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from foretouch.models.contact import features
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.contact.regressors import Forest
from foretouch.models.touch_model import Estimate
from foretouch.types import Bool, Cloud, Float64, Grasp

_AROUND = [k for k, name in enumerate(features.FEATURES) if name.startswith(("g1_", "g2_")) and "_depth" not in name]
"""Columns that describe the points around each contact."""


def fewer_trees(estimator: ContactEstimator, count: int) -> ContactEstimator:
    """The same model with the first trees of each forest alone: as if it had been fitted with so many."""
    return replace(estimator, forests={name: _first_trees(one, count) for name, one in estimator.forests.items()})


def _first_trees(forest: Forest, count: int) -> Forest:
    """The first trees of a forest, with their nodes and values alone."""
    if count >= len(forest.roots):
        return forest
    nodes = int(forest.roots[count])
    leaves = int(forest.leaf[:nodes].max()) + 1
    cut = {name: getattr(forest, name)[:nodes] for name in ("feature", "threshold", "children", "leaf")}
    return Forest(roots=forest.roots[:count], value=forest.value[:leaves], **cut)


@dataclass(frozen=True, eq=False)
class GlobalFeaturesOnly(ContactEstimator):
    """A contact model that does not look at the points around the contacts: it takes their means in training.

    The object, the hand and the place of the grasp on the object are described as before.
    """

    @classmethod
    def of(cls, estimator: ContactEstimator) -> Self:
        """From a fitted model."""
        return cls(**{name: getattr(estimator, name) for name in estimator.__dataclass_fields__})

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """See `Estimator.estimate`."""
        return Estimate(*self.predict_rows(features.HandFrameFeatures(cloud.xyz).describe(grasps, surroundings=False)))

    def predict_rows(self, rows: Float64) -> tuple[Float64, Bool]:
        """As `ContactEstimator.predict_rows`."""
        plain = rows.copy()
        plain[:, _AROUND] = self.kernel.centre[np.array(_AROUND) - len(features.CONDITIONS)]
        return super().predict_rows(plain)
