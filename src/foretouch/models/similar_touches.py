# SPDX-License-Identifier: Apache-2.0
"""Touches of one object by where it was touched: grasps of one object that look alike read alike.

The noise of a grasp, in eq. 1 of `models.state_space`, consists of a smooth function of the geometry of both contacts and
of what is new with each grasp, a Gaussian process [Rasmussen and Williams 2006, ch. 2] for each value:

    noise = g(where) + rest,   cov g(a), g(b) = r k(|a - b|),   k(d) = (1 + d) exp(-d),   var rest = 1             (1)

`where` are the features of the grasp in the frame of the hand (`models.contact.features`), which no motion of the camera
and the object together changes, in units of the deviation between the grasps of one training object times a length. r is
a number for each modality. Around the level of the tracker, n earlier touches predict g at another grasp with the weights

    w = r k (r K + 1)⁻¹                                                                                            (2)

and leave the share (1 + r - r w·k) / (1 + r) of the noise's variance. Far from all touches w is 0 and the share 1. The first
two touches of an object determine its level, and places take part from the third one on. By the eigenvectors of K, which
the values have in common, a prediction is linear in n for each value.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np

from foretouch.models.state_space import TrackerParameters
from foretouch.types import Float64

MOST: Final = 64
"""Touches that are kept; older ones are left out."""

_FEWEST: Final = 3


@dataclass(frozen=True, eq=False)
class SimilarTouches:
    """Touches of the current object; immutable."""

    parameters: TrackerParameters
    where: Float64  # (n, P) features of the grasps
    readings: Float64  # (n, D) without what vision and temperature predict of them [counts]

    @classmethod
    def none(cls, parameters: TrackerParameters) -> Self:
        """Before the first touch."""
        return cls(parameters, np.empty((0, len(parameters.where_scale))), np.empty((0, parameters.channels.size)))

    @property
    def enough(self) -> bool:
        """Whether these touches are compared with the next ones."""
        return len(self.where) >= _FEWEST

    def added(self, where: Float64, reading: Float64) -> Self:
        """Return the touches with one more, of (P,) features."""
        wheres, readings = np.vstack([self.where, where])[-MOST:], np.vstack([self.readings, reading])[-MOST:]
        return type(self)(self.parameters, wheres, readings)

    def regress(self, where: Float64, level: Float64) -> tuple[Float64, Float64]:
        """Return what grasps with (K, P) features differ from a (D,) level by; each as it is alone, to the last bit.

        The level is the reading of a grasp on this object that is like no other, as `readings`. The results are (K, D)
        differences [counts], and (K, M) shares of the variance of the noise that are left.
        """
        vectors, gain = self._solved
        near = (self._kernel(where)[:, None] @ vectors)[:, 0]  # (K, n): one product a grasp
        owner, ratio = self.parameters.channels.modality_of_value, self.parameters.where_ratio
        change = (near[:, None] @ (gain[owner].T * (vectors.T @ (self.readings - level))))[:, 0]
        explained = ((near * near)[:, None] @ gain.T)[:, 0] * (ratio / (1.0 + ratio))
        return change, 1.0 - explained

    def _kernel(self, where: Float64) -> Float64:
        """Return the (K, n) k of eq. 1."""
        from scipy.spatial.distance import cdist  # for `--help` without SciPy

        distance = cdist(where / self.parameters.where_scale, self.where / self.parameters.where_scale)
        return np.asarray((1.0 + distance) * np.exp(-distance), np.float64)

    @cached_property
    def _solved(self) -> tuple[Float64, Float64]:
        """(n, n) eigenvectors of K as columns, and (M, n) diagonals of r (r K + 1)⁻¹ in their coordinates."""
        values, vectors = np.linalg.eigh(self._kernel(self.where))
        ratio = self.parameters.where_ratio[:, None]
        return vectors, ratio / (ratio * np.maximum(values, 0.0) + 1.0)
