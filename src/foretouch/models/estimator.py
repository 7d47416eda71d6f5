# SPDX-License-Identifier: Apache-2.0
"""What the kinds of touch models implement: a prediction from the cloud and the grasp alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from foretouch.tactile import Ranges
from foretouch.types import Bool, Cloud, Float64, Grasp, Plane
from foretouch.types.summary import Summarised

UNFAMILIAR: Final[Mapping[str, str]] = {
    "larger_object": "the object is larger than any of the training",
    "smaller_object": "the object is smaller than any of the training",
    "other_shape": "no object of the training has these proportions",
    "wider_grasp": "the contacts are farther apart than in the training",
    "narrower_grasp": "the contacts are nearer to each other than in the training",
    "other_direction": "the hand comes from a direction that the training lacks",
    "sparse_points": "the points are too few for this object",
}
"""Flags beside `unfamiliar`, and what they mean."""

UNFAMILIAR_CURE: Final = (
    "unfamiliar: the training holds nothing like it, so the prediction is near the mean of the training readings. "
    "Give readings of the object (--touched, or executed_grasp in the graph), or train on 20 grasps of such objects: "
    "docs/tutorials/own_model.md"
)
"""What a prediction with the flag `unfamiliar` is worth, and what to do."""


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Summarised):
    """Predictions for K grasps on one cloud, before tare, touches and intervals are applied."""

    counts: Float64  # (K, D) float64 [counts]
    in_distribution: Bool  # (K,) bool: whether cloud and grasp resemble the training
    where: Float64 | None = None  # (K, P) features of the grasps, by which touches of one object are compared
    # (K,) bool each, why grasps are not in distribution, by flag
    reasons: Mapping[str, Bool] = field(default_factory=dict)


class Estimator(Protocol):
    """Predicts touch from the cloud and the grasp alone; what the kinds of touch models implement."""

    @property
    def ranges(self) -> Ranges:
        """Ranges outside which a predicted value is flagged."""
        ...

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """Predict K grasps; the cloud's features are computed once. Without a table the camera looks straight down on it.

        Raises:
            CloudError: If the cloud holds too few points or all at one position.
            ModelError: If it lacks a channel that the model needs.
        """
        ...
