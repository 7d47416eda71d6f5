# SPDX-License-Identifier: Apache-2.0
"""Familiarity: whether a cloud and a grasp, described in the hand's frame, resemble those that a model was trained on.

Sizes of the object as in `novelty.SizeNoveltyDetector`, without the number of points; and conditions under which the
training data say nothing: another distance, too few points, another width or direction of the hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.models.contact.hand_features import CHECKED, OBJECT_FEATURES
from foretouch.models.novelty import NEAREST, SizeNoveltyDetector
from foretouch.types import Float64

_ALMOST_ALL: Final = (0.01, 0.99)  # quantiles of a condition in training
_BEYOND: Final = {"distance": 2.0, "spacing": 2.5, "width": 1.5}  # factors beyond them
_TURN: Final = 0.05  # what is added to the directions of the hand, which are cosines
_LIMITED: Final = tuple(name for name in CHECKED if name not in OBJECT_FEATURES)
_LIMITED_COLUMNS: Final = [CHECKED.index(name) for name in _LIMITED]


@dataclass(frozen=True, eq=False)
class FamiliarityDetector(SizeNoveltyDetector):
    """Sizes of S training clouds, and the limits of the conditions in `CHECKED`."""

    low: Float64  # (5,) float64 of `CHECKED` without `OBJECT_FEATURES`
    high: Float64  # (5,) float64 of `CHECKED` without `OBJECT_FEATURES`

    COLUMNS: ClassVar[list[int]] = [CHECKED.index(name) for name in OBJECT_FEATURES]

    @classmethod
    def fit(cls, objects: Float64) -> Self:
        """From (S, F) rows of training grasps, whose first columns are `CHECKED`; S of at least 5."""
        low, high = np.quantile(objects[:, _LIMITED_COLUMNS], _ALMOST_ALL, axis=0)
        for k, name in enumerate(_LIMITED):
            factor = _BEYOND.get(name)
            low[k], high[k] = (
                (low[k] - _TURN, high[k] + _TURN) if factor is None else (low[k] / factor, high[k] * factor)
            )
        low[_LIMITED.index("spacing")] = 0.0  # points cannot be too many
        return cls(*cls._fit_sizes(objects), low, high)

    def scores(self, rows: Float64) -> Float64:
        """(K,) of (K, F) rows: as `in_distribution_score` by sizes, and 0 outside the limits."""
        sizes = (rows[:, self.COLUMNS] - self.centre) / self.scale
        distance = np.partition(cdist(sizes, self.known, "cityblock"), NEAREST - 1, axis=1)[:, :NEAREST].mean(axis=1)
        low, high = self.span
        limited = rows[:, _LIMITED_COLUMNS]
        inside = ((limited >= self.low) & (limited <= self.high)).all(axis=1)
        return np.where(inside, np.clip((high - distance) / (high - low), 0.0, 1.0), 0.0)

    def in_distribution_score(self, row: Float64) -> float:
        """As `scores`, of one row."""
        return float(self.scores(row[None])[0])

    def _check(self) -> None:
        super()._check()
        for name in ("low", "high"):
            found = getattr(self, name)
            if found.shape != (len(_LIMITED),) or not np.isfinite(found).all():
                raise ModelError(f"{name}: shape {found.shape} is not ({len(_LIMITED)},), or a value is not finite")
