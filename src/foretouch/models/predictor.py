# SPDX-License-Identifier: Apache-2.0
"""The protocol of touch models: a prediction from the cloud and the grasp alone, by foretouch's own models and by yours.

    class Mine:
        def estimate(self, cloud, grasps, table=None):
            return counts  # (K, D), or Estimate(counts, familiar)

A predictor may have more, all of it optional:

- `fit(samples)` fits it to labelled samples. It is then fitted again without the samples of each fold, where it is calibrated
  and evaluated.
- NumPy arrays among its attributes are saved with the model and set again when it is loaded; nothing is pickled. For other
  data, `to_tensors()` returns arrays by name, and the class method `from_tensors(tensors)` makes a predictor of them.
- `uses_colours` is whether it reads `cloud.rgb`; by default it may. A node receives colours only for those who use them.
- `ranges` are the `Ranges` outside which a value is flagged `out_of_range`; by default those of the sensor.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError, require_type
from foretouch.types import Bool, Cloud, Float64, Grasps, Plane
from foretouch.types.arrays import numbers
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
    familiar: Bool | None = None  # (K,) bool: whether cloud and grasp resemble the training; None if that is not known
    where: Float64 | None = None  # (K, P) features of the grasps, by which touches of one object are compared
    # (K,) bool each, why grasps are unfamiliar, by flag
    reasons: Mapping[str, Bool] = field(default_factory=dict)

    @classmethod
    def of(cls, answer: Any, rows: int, values: int) -> Self:
        """Return the answer of a predictor for some grasps, as an estimate.

        Args:
            answer: (rows, values) numbers [counts], or an `Estimate`; the arrays may be of another library that NumPy reads.
            rows: K.
            values: D.

        Raises:
            ModelError: If an array has another shape.
        """
        estimate = answer if isinstance(answer, cls) else cls(answer)
        rule = f"{rows} grasps and {values} values need ({rows}, {values})"
        try:
            counts = numbers(estimate.counts, "estimate: returned counts", ModelError)
        except ModelError as err:
            raise ModelError(f"{err}; {rule}") from err
        if counts.shape != (rows, values):
            raise ModelError(f"estimate: returned counts of shape {counts.shape}; {rule}")
        require_type(estimate.reasons, Mapping, "estimate: returned reasons", "not masks by flag", ModelError)
        familiar = None if estimate.familiar is None else _mask(estimate.familiar, "familiar", rows)
        reasons = {flag: _mask(mask, f"reasons[{flag!r}]", rows) for flag, mask in estimate.reasons.items()}
        where = None if estimate.where is None else numbers(estimate.where, "estimate: returned where", ModelError)
        if where is not None and (where.ndim != 2 or len(where) != rows):
            raise ModelError(f"estimate: returned where of shape {where.shape}; {rows} grasps need ({rows}, P)")
        return cls(counts, familiar, where, reasons)

    @property
    def known(self) -> Bool:
        """(K,) bool: which grasps get the intervals of known objects; none where that is not known."""
        return np.zeros(len(self.counts), np.bool_) if self.familiar is None else self.familiar


def _mask(mask: Any, name: str, rows: int) -> Bool:
    """Return (rows,) bool of an answer; a `ModelError` names what is none."""
    array = np.asarray(mask)
    if array.shape != (rows,) or array.dtype != np.bool_:
        rule = f"{rows} grasps need ({rows},) of bool"
        raise ModelError(f"estimate: returned {name} of shape {array.shape} and type {array.dtype}; {rule}")
    return array


class Predictor(Protocol):
    """Predicts touch from the cloud and the grasp alone."""

    def estimate(self, cloud: Cloud, grasps: Grasps, table: Plane | None = None) -> Estimate | npt.ArrayLike:
        """Predict K grasps on the points of one object.

        Args:
            cloud: (N, 3) points [m].
            grasps: K grasps in the frame of the cloud.
            table: In the same frame; without one the camera looks straight down on it.

        Returns:
            (K, D) numbers in the unit of the sensor, in the order of its channels (`model.sensor.channels`). Or an `Estimate`,
            which also says which grasps resemble the training.

        Raises:
            CloudError: If the cloud holds too few points or all at one position.
            ModelError: If it lacks a channel that the model needs.
        """
        ...
