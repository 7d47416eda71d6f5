# SPDX-License-Identifier: Apache-2.0
"""What the points of an object show of its shape; and by it, whether a network was trained on such objects.

A network does not detect objects unlike those of training: on the public recordings it is far worse than the mean of
the training labels on an object that was left out. So the distance of a cloud's sizes from the nearest training clouds
is compared with the usual distances within training, and predictions fade to that mean. On the public recordings this
detects nine in ten grasps on an object that was left out, at one false alarm in twenty; it cannot detect an object of
the same size and shape as one of the training objects.

Gross errors (a house instead of a can, metres mistaken for millimetres, a grasp beside the object) are found by
`network.preparation.LengthRangeCheck`. The contact model has its own detector (`contact.estimator.NoveltyDetector`), and needs no
fallback, because its kernel fades to the mean by itself.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.cloud.geometry.columns import centred_columns, distances
from foretouch.errors import CloudError, ModelError
from foretouch.models.files import TensorRecord
from foretouch.types import Bool, Float32, Float64
from foretouch.types.channels import Channels

IN_DISTRIBUTION: Final = 0.5
"""The lowest score of an object that counts as in distribution."""

_NEAREST: Final = 3
_USUAL: Final = (0.90, 0.97)  # quantiles of the distances within training between which the score falls from 1 to 0
_MINIMUM_POINTS: Final = 8


def usable_points(xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> Float64:
    """Return (M, 3) float64: the finite points of a cloud; raises `CloudError` if they show no shape."""
    points = np.ascontiguousarray(xyz, np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        points = points[np.isfinite(points).all(axis=1)]
    if len(points) < _MINIMUM_POINTS:
        raise CloudError(f"cloud: {len(points)} finite points are fewer than {_MINIMUM_POINTS}")
    if (points[-1] == points[0]).all() and (points == points[0]).all():
        raise CloudError(f"cloud: all {len(points)} finite points are in one place")
    return points


def principal_axes(covariance: Float64) -> tuple[Float64, Float64]:
    """Return (…, 3) standard deviations along the principal axes, ascending, and the axes as columns of (…, 3, 3)."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0)), axes


def object_sizes(xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> Float64:
    """Return (8,) float64 of (N, 3) points [m]: extents along x, y, z, principal deviations, radius, logarithm of their number.

    Raises:
        CloudError: If fewer than eight points are finite, or all are at one position.
    """
    points = usable_points(xyz)
    _, columns, covariance = centred_columns(points)
    deviations, _ = principal_axes(covariance)
    return np.concatenate([np.ptp(points, axis=0), deviations, [distances(columns).max(), np.log(len(points))]])


def standardisation(rows: Float64) -> tuple[Float64, Float64]:
    """Return the mean and deviation of each column; 1 where a column is constant."""
    deviation = rows.std(axis=0)
    return rows.mean(axis=0), np.where(deviation > 1e-9, deviation, 1.0)  # a smaller one is rounding [m or 1]


@dataclass(frozen=True, eq=False)
class Fallback(TensorRecord):
    """Sizes of S training clouds, and the mean of the training labels, to which predictions fade on other objects."""

    channels: Channels  # of the labels
    centre: Float64  # (8,) float64, which standardise `object_sizes`
    scale: Float64  # (8,) float64, which standardise `object_sizes`
    known: Float32  # (S, 8) float32, standardised
    span: Float64  # (2,) float64: the distances up to which the score is 1, and from which it is 0
    mean: Float64  # (D,) float64 of the training labels [counts]

    RULES = {"centre": "8", "scale": ("8", 1e-12, 1e12), "known": "S8", "span": "2", "mean": "D"}  # noqa: RUF012

    @classmethod
    def fit(cls, channels: Channels, sizes: Float64, labels: Float64) -> Self:
        """Fit to the (S, 8) sizes of the training clouds, S of at least 5, and their (S, D) labels [counts]."""
        centre, scale = standardisation(sizes)
        known = ((sizes - centre) / scale).astype(np.float32)
        distance = np.sort(cdist(known, known, "cityblock"), axis=1)[:, 1 : _NEAREST + 1].mean(axis=1)
        low, high = np.quantile(distance, _USUAL)
        return cls(channels, centre, scale, known, np.array([low, max(high, low + 1e-9)]), labels.mean(axis=0))

    def score(self, sizes: Float64) -> float:
        """Compare (8,) sizes of a cloud with the training: 1 where they are alike, 0 where not; see `IN_DISTRIBUTION`."""
        apart = np.abs(self.known - (sizes - self.centre) / self.scale).sum(axis=1)
        low, high = self.span
        return float(np.clip((high - np.partition(apart, _NEAREST - 1)[:_NEAREST].mean()) / (high - low), 0.0, 1.0))

    def fade(self, counts: Float64, sizes: Float64) -> tuple[Float64, Bool]:
        """Predictions, the closer to the mean the less an object resembles the training objects.

        Args:
            counts: (K, D) of the network [counts].
            sizes: (K, 8) of their clouds, or (1, 8) if all were made from one cloud.

        Returns:
            (K, D) [counts], and (K,) whether the object is in distribution.
        """
        scores = np.array([self.score(row) for row in sizes])
        weight = scores[:, None]
        inside = np.broadcast_to(scores >= IN_DISTRIBUTION, len(counts))
        return weight * counts + (1.0 - weight) * self.mean, inside

    def _check(self) -> None:
        super()._check()
        if len(self.known) < _NEAREST or not self.span[0] < self.span[1]:
            raise ModelError("known, span: too few clouds, or a span that is empty")
