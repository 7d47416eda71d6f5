# SPDX-License-Identifier: Apache-2.0
"""Five lengths of a cloud and a grasp, and whether they are within their ranges in training."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from foretouch.errors import ModelError
from foretouch.kernels import Kernel
from foretouch.models.network.preparation import PreparedCloud
from foretouch.types import Bool, Float64, Grasp, stacked

_nearest_squares = Kernel("nearest_squares", np.float32, int, np.float32, int, np.float32)

LENGTHS: Final = ("range_m", "radius_m", "width_m", "offset_m", "gap_m")
"""Distance of the cloud from the camera, its radius about its centroid, the distance of the contacts from each
other, of their midpoint from the centroid, and of the farther contact from the nearest point that the model uses."""

_MARGIN: Final = 0.1  # of a length's range, by which a grasp may leave it


@dataclass(frozen=True, eq=False)
class LengthRangeCheck:
    """Ranges of the five lengths over the training samples, widened by a tenth on both sides."""

    low: Float64  # (5,) float64 [m], in the order of `LENGTHS`
    high: Float64  # (5,) float64 [m], in the order of `LENGTHS`

    @classmethod
    def fit(cls, lengths: Float64) -> Self:
        """From (S, 5) lengths of the training samples."""
        return cls(lengths.min(axis=0), lengths.max(axis=0))

    @classmethod
    def from_card(cls, ranges: Mapping[str, Sequence[float]]) -> Self:
        """From `to_card`.

        Raises:
            ModelError: If a length is missing or its range is not [low, high].
        """
        try:
            low, high = np.array([ranges[name] for name in LENGTHS], np.float64).T
            if not (low <= high).all():
                raise ValueError("a low end is above the high one")
        except (KeyError, TypeError, ValueError) as err:
            raise ModelError(f"familiar: must give [low, high] for each of {', '.join(LENGTHS)}") from err
        return cls(low, high)

    def to_card(self) -> dict[str, list[float]]:
        """Plain data for the card's field `familiar`."""
        return {name: [float(a), float(b)] for name, a, b in zip(LENGTHS, self.low, self.high, strict=True)}

    def within(self, lengths: Float64) -> Bool:
        """(K,) whether all five of each of (K, 5) lengths are in their ranges."""
        margin = _MARGIN * (self.high - self.low)
        inside = (lengths >= self.low - margin) & (lengths <= self.high + margin)
        return np.asarray(inside.all(axis=1), np.bool_)


def grasp_lengths(prepared: PreparedCloud, grasps: Sequence[Grasp]) -> Float64:
    """(K, 5) float64 [m]: the `LENGTHS` of each grasp on a cloud."""
    if not grasps:
        return np.empty((0, len(LENGTHS)))
    frame = prepared.frame
    g1, g2, _ = stacked(grasps)
    offset = np.linalg.norm((g1 + g2) / 2.0 - frame.centre, axis=1)
    width = np.linalg.norm(g1 - g2, axis=1)
    cloud = [float(np.linalg.norm(frame.centre)), frame.scale]
    gap = np.maximum(_nearest(prepared, g1), _nearest(prepared, g2))
    return np.column_stack([np.tile(cloud, (len(grasps), 1)), width, offset, gap])


def _nearest(prepared: PreparedCloud, targets: Float64) -> Float64:
    """(T,) distance of (T, 3) points from the nearest sampled point [m]."""
    moved, points = prepared.frame.apply_points(targets).astype(np.float32), prepared.points[:, :3]
    squared = np.empty(len(moved), np.float32)
    _nearest_squares(moved, len(moved), points.T.copy(), len(points), squared)
    return np.asarray(np.sqrt(squared) * prepared.frame.scale, np.float64)
