# SPDX-License-Identifier: Apache-2.0
"""Novelty detection: whether a cloud and a grasp resemble those that a model was trained on.

Two tests are combined. `SizeNoveltyDetector` looks at the object alone: the distance of a cloud's sizes from the
nearest training clouds, relative to the usual distances within the training objects. On the public recordings it
detects nine in ten grasps on an object that was left out, at one false alarm in twenty; it cannot detect an object of
the same size and shape as one of the training objects. `network.length_check.LengthRangeCheck` compares five lengths of
a cloud and a grasp with their ranges in training. It finds gross errors (a house instead of a can, metres mistaken for
millimetres, a grasp beside the object) and passes objects of another make and of usual size. Networks use both; a
contact model uses the first alone.

`Fallback` applies the detector to networks. A network does not detect objects unlike those of training: on the public
recordings it is far worse than the mean of the training labels on an object that was left out. The contact model
needs no fallback, because its kernel fades to that mean by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.models.files import TensorRecord
from foretouch.types import TOUCH_SIZE, Float32, Float64

IN_DISTRIBUTION: Final = 0.5
"""The lowest score of an object that counts as in distribution."""

OBJECT_FEATURES: Final = (
    *("x", "y", "z"),
    *("extent_x", "extent_y", "extent_z"),
    *("spread_1", "spread_2", "spread_3"),
    *("radius", "log_points"),
    *("axis_x", "axis_y", "axis_z"),
    *("radius_q25", "radius_q50", "radius_q75"),
)
SHAPE_FEATURES: Final = OBJECT_FEATURES[3:11]
"""Sizes alone, which distinguish objects independently of pose and position."""

_CONSTANT: Final = 1e-9  # [m or 1]; a smaller deviation of a column is rounding
_COLUMNS: Final = [OBJECT_FEATURES.index(name) for name in SHAPE_FEATURES]
_NEAREST: Final = 3
_USUAL: Final = (0.90, 0.97)  # quantiles of the distances within training between which the score falls from 1 to 0


def standardisation(rows: Float64) -> tuple[Float64, Float64]:
    """Mean and deviation of each column; 1 where a column is constant."""
    deviation = rows.std(axis=0)
    return rows.mean(axis=0), np.where(deviation > _CONSTANT, deviation, 1.0)


@dataclass(frozen=True, eq=False)
class SizeNoveltyDetector(TensorRecord):
    """Sizes of S training clouds."""

    centre: Float64  # (8,) float64, which standardise `SHAPE_FEATURES`
    scale: Float64  # (8,) float64, which standardise `SHAPE_FEATURES`
    known: Float32  # (S, 8) float32, standardised
    span: Float64  # (2,) float64: the distances up to which the score is 1, and from which it is 0

    @classmethod
    def fit(cls, objects: Float64) -> SizeNoveltyDetector:
        """From (S, len(OBJECT_FEATURES)) descriptions of the training clouds; S of at least 5."""
        sizes = objects[:, _COLUMNS]
        centre, scale = standardisation(sizes)
        known = ((sizes - centre) / scale).astype(np.float32)
        distance = np.sort(cdist(known, known, "cityblock"), axis=1)[:, 1 : _NEAREST + 1].mean(axis=1)
        low, high = np.quantile(distance, _USUAL)
        return cls(centre, scale, known, np.array([low, max(high, low + 1e-9)]))

    def scores(self, rows: Float64) -> Float64:
        """(K,) `in_distribution_score` of (K, F) rows, whose first columns are `OBJECT_FEATURES`."""
        return np.array([self.in_distribution_score(row[: len(OBJECT_FEATURES)]) for row in rows], np.float64)

    def in_distribution_score(self, object_features: Float64) -> float:
        """1 for a cloud like those of training, 0 for one unlike them; compare with `IN_DISTRIBUTION`."""
        sizes = (object_features[_COLUMNS] - self.centre) / self.scale
        distance = np.partition(np.abs(self.known - sizes).sum(axis=1), _NEAREST - 1)[:_NEAREST].mean()
        low, high = self.span
        return float(np.clip((high - distance) / (high - low), 0.0, 1.0))

    def _check(self) -> None:
        size = len(_COLUMNS)
        for name, shape in (("centre", (size,)), ("scale", (size,)), ("known", (-1, size)), ("span", (2,))):
            found = getattr(self, name)
            fits = found.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, found.shape, strict=True))
            if not fits or not np.isfinite(found).all():
                raise ModelError(f"{name}: shape {found.shape} is not {shape}, or a value is not finite")
        if not (self.scale > 0.0).all():
            raise ModelError("scale: a value is not above 0")
        if len(self.known) < _NEAREST or not self.span[0] < self.span[1]:
            raise ModelError("known, span: too few clouds, or a span that is empty")


@dataclass(frozen=True, eq=False)
class Fallback:
    """The mean of the training labels, to which a network's predictions fade as an object leaves the distribution."""

    novelty: SizeNoveltyDetector  # fitted to the training objects
    mean: Float64  # (50,) float64 of the training labels [counts]

    @classmethod
    def fit(cls, objects: Float64, labels: Float64) -> Fallback:
        """From (S, len(OBJECT_FEATURES)) descriptions of the training clouds and their (S, 50) labels [counts]."""
        return cls(SizeNoveltyDetector.fit(objects), labels.mean(axis=0))

    def fade(self, counts: Float64, objects: Float64) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """Predictions, the closer to the mean the less an object resembles the training objects.

        Args:
            counts: (K, 50) of the network [counts].
            objects: (K, len(OBJECT_FEATURES)) of their clouds, or (1, …) if all were made from one cloud.

        Returns:
            (K, 50) [counts], and (K,) whether the object is in distribution.
        """
        scores = np.array([self.novelty.in_distribution_score(row) for row in objects])
        weight = scores[:, None]
        inside = np.broadcast_to(scores >= IN_DISTRIBUTION, len(counts))
        return weight * counts + (1.0 - weight) * self.mean, inside

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
        return cls(SizeNoveltyDetector.from_tensors(tensors), np.asarray(mean, np.float64))
