# SPDX-License-Identifier: Apache-2.0
"""What every kind of touch model gives before tare, touches and doubt are brought in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from foretouch.tactile.ranges import TactileRanges
from foretouch.types import Cloud, Float64, Grasp

__all__ = ["Estimate", "Estimator"]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Of K grasps on one cloud.

    Attributes:
        counts: (K, 50) float64 [counts].
        familiar: (K,) bool: whether cloud and grasp are like those of training.
    """

    counts: Float64
    familiar: npt.NDArray[np.bool_]


class Estimator(Protocol):
    """Something that predicts touch from sight alone."""

    @property
    def ranges(self) -> TactileRanges:
        """Beyond which a value is told to be out of range."""
        ...

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """Predict K grasps; the cloud's features are computed once.

        Raises:
            CloudError: If the cloud holds too few points or all in one place.
            ModelError: If it lacks a channel that the model needs.
        """
        ...
