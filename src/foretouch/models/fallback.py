# SPDX-License-Identifier: Apache-2.0
"""What a network falls back to on objects unlike those that it was trained on: the mean of its training labels.

A network has no notion of what it does not know: on the public recordings it is far worse than that mean on an object that was left
out. The contact model needs none of this, for its kernel fades by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError
from foretouch.models.novelty import FAMILIAR, Novelty
from foretouch.types import TOUCH_SIZE, Float64

__all__ = ["Fallback"]


@dataclass(frozen=True, eq=False)
class Fallback:
    """Where predictions fade to, and how fast.

    Attributes:
        novelty: Of the training objects.
        mean: (50,) float64 of the training labels [counts].
    """

    novelty: Novelty
    mean: Float64

    @classmethod
    def fit(cls, objects: Float64, labels: Float64) -> Fallback:
        """From (S, len(OBJECT_FEATURES)) descriptions of the training clouds and their (S, 50) labels [counts]."""
        return cls(Novelty.fit(objects), labels.mean(axis=0))

    def fade(self, counts: Float64, objects: Float64) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """Predictions, nearer to the mean the less familiar the object is.

        Args:
            counts: (K, 50) of the network [counts].
            objects: (K, len(OBJECT_FEATURES)) of the clouds that they were made from, or (1, …) of the one of all.

        Returns:
            (K, 50) [counts], and (K,) whether the object is familiar.
        """
        familiarity = np.array([self.novelty.familiarity(row) for row in objects])
        weight = familiarity[:, None]
        known = np.broadcast_to(familiarity >= FAMILIAR, len(counts))
        return weight * counts + (1.0 - weight) * self.mean, known

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        return {**self.novelty.to_tensors(), "mean": self.mean}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]]) -> Fallback:
        """From `to_tensors`.

        Raises:
            ModelError: If an array is missing or damaged.
        """
        mean = tensors.get("mean")
        if mean is None or mean.shape != (TOUCH_SIZE,) or not np.isfinite(mean).all():
            raise ModelError("mean: is missing, of another shape, or not finite")
        return cls(Novelty.from_tensors(tensors), np.asarray(mean, np.float64))
