# SPDX-License-Identifier: Apache-2.0
"""Novelty detection: whether a cloud and a grasp, in the frame of the hand, resemble those that a model was trained on.

The sizes of a cloud are compared with those of the nearest training cloud, by a distance that counts less what varies
between clouds of one object: its pose, and what is seen of it. Conditions under which the training data say nothing
are unfamiliar too: another distance of the camera, too few points, another width or direction of the hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.spatial.distance import cdist

from foretouch.errors import ModelError
from foretouch.models.contact.features import CHECKED, OBJECT_FEATURES
from foretouch.models.files import TensorRecord
from foretouch.models.novelty import standardisation
from foretouch.types import Float64

_USUAL: Final = (0.93, 0.98)  # quantiles of the distances within training between which the score falls from 1 to 0
_LEAST: Final = 0.05  # variance within objects that a size has at least, over that between all clouds
_BEYOND: Final = {"distance": 2.0, "spacing": 2.5, "width": 1.5}  # factors beyond them
_TURN: Final = 0.05  # what is added to the directions of the hand, which are cosines
_SIZES: Final = [CHECKED.index(name) for name in OBJECT_FEATURES]
_LIMITED: Final = tuple(name for name in CHECKED if name not in OBJECT_FEATURES)
_LIMITED_COLUMNS: Final = [CHECKED.index(name) for name in _LIMITED]


@dataclass(frozen=True, eq=False)
class NoveltyDetector(TensorRecord):
    """Sizes of S training clouds, and the limits of the conditions in `CHECKED`."""

    centre: Float64  # (11,) float64, mean of the sizes
    turn: Float64  # (11, 11) float64: differences of sizes times it have unit variance within objects
    known: Float64  # (S, 11) float64, sizes minus `centre`, times `turn`
    span: Float64  # (2,) float64: the distances up to which the score is 1, and from which it is 0
    low: Float64  # (5,) float64 of `CHECKED` without `OBJECT_FEATURES`
    high: Float64  # (5,) float64 of `CHECKED` without `OBJECT_FEATURES`

    @classmethod
    def fit(cls, rows: Float64, objects: Sequence[str]) -> Self:
        """From (S, F) rows of training grasps, whose first columns are `CHECKED`, and their objects.

        S of at least 5.
        """
        sizes = rows[:, _SIZES]
        centre, scale = standardisation(sizes)
        within = (sizes - centre) / scale
        names = np.asarray(objects)
        for name in np.unique(names):
            within[names == name] -= within[names == name].mean(axis=0)
        values, axes = np.linalg.eigh(within.T @ within / len(within) + _LEAST * np.eye(len(centre)))
        turn = axes / np.sqrt(values) / scale[:, None]
        known = (sizes - centre) @ turn
        start, end = np.quantile(np.sort(cdist(known, known), axis=1)[:, 1], _USUAL)
        low, high = np.quantile(rows[:, _LIMITED_COLUMNS], (0.01, 0.99), axis=0)
        for k, name in enumerate(_LIMITED):
            factor = _BEYOND.get(name)
            low[k], high[k] = (
                (low[k] - _TURN, high[k] + _TURN) if factor is None else (low[k] / factor, high[k] * factor)
            )
        low[_LIMITED.index("spacing")] = 0.0  # points cannot be too many
        return cls(centre, turn, known, np.array([start, max(end, start + 1e-9)]), low, high)

    def scores(self, rows: Float64) -> Float64:
        """(K,) of (K, F) rows: 1 where they are like those of training, 0 where unlike.

        Compare with `IN_DISTRIBUTION`.
        """
        moved = ((rows[:, _SIZES] - self.centre)[:, :, None] * self.turn).sum(axis=1)  # the same for any K
        distance = cdist(moved, self.known).min(axis=1)
        start, end = self.span
        limited = rows[:, _LIMITED_COLUMNS]
        inside = ((limited >= self.low) & (limited <= self.high)).all(axis=1)
        return np.where(inside, np.clip((end - distance) / (end - start), 0.0, 1.0), 0.0)

    def _check(self) -> None:
        size, limits = len(_SIZES), (len(_LIMITED),)
        self._require({"centre": (size,), "turn": (size, size), "known": (-1, size), "span": (2,)})
        self._require({"low": limits, "high": limits})
        if not len(self.known) or not self.span[0] < self.span[1]:
            raise ModelError("known, span: no cloud, or a span that is empty")
