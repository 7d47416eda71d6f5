# SPDX-License-Identifier: Apache-2.0
"""Keep the best grasp of an object from cloud to cloud of a stream."""

from dataclasses import replace
from typing import Final

import numpy as np

from foretouch.cloud.geometry.columns import centred_columns
from foretouch.types import Cloud, Float64, Grasp, Grasps

APART_M: Final = 0.01
"""Distance by which grasps of one plan differ in one of their contacts, at least."""

_OUTDONE = 3  # clouds in a row on which another grasp must be better


HeldGrasp = tuple[Grasp, int]
"""The best grasp of an object in an earlier cloud of a stream, and on how many clouds in a row another was better."""

_Place = tuple[Float64, Float64]
"""(3,) float64 centroid and (3,) float64 mean deviation of x, y, z from it, of the points of an object [m]."""


class GraspHold:
    """The last best grasp of each object of a stream.

    Objects have no identity from cloud to cloud: an object is the same if position and size are within a tolerance of
    those for which its grasp was planned, so that small motions do not add up.

    Args:
        tolerance_m: Largest change of any coordinate of position and size [m].
    """

    def __init__(self, tolerance_m: float) -> None:
        self._tolerance_m = tolerance_m
        self._last: list[tuple[_Place, HeldGrasp]] = []  # where each object was when its held grasp was planned
        self._fresh: list[tuple[_Place, HeldGrasp]] = []
        self._measured: tuple[Cloud, _Place] | None = None  # by the last call

    def find(self, cloud: Cloud) -> HeldGrasp | None:
        """Return the grasp that was planned on this object, if the object is still the same.

        Args:
            cloud: The object now.
        """
        held = self._find(self._measure(cloud))
        return None if held is None else held[1]

    def remember(self, cloud: Cloud, best: HeldGrasp) -> None:
        """Keep the best grasp of an object for the next cloud.

        Args:
            cloud: The object now.
            best: Its best grasp, and for how many clouds another one was better.
        """
        now = self._measure(cloud)
        before = self._find(now)
        same = before is not None and np.array_equal(_contacts(before[1][0]), _contacts(best[0]))
        self._fresh.append((before[0], (before[1][0], best[1])) if before is not None and same else (now, best))

    def next_cloud(self) -> None:
        """Forget the objects that the last cloud did not hold."""
        self._last = self._fresh
        self._fresh = []
        self._measured = None

    def _measure(self, cloud: Cloud) -> _Place:
        """`_measure` of a cloud, for which it is asked twice."""
        if self._measured is None or self._measured[0] is not cloud:
            self._measured = (cloud, _measure(cloud))
        return self._measured[1]

    def _find(self, now: _Place) -> tuple[_Place, HeldGrasp] | None:
        for place, held in self._last:
            if np.abs(np.subtract(place, now)).max() <= self._tolerance_m:
                return place, held
        return None


def keep_held(held: HeldGrasp, held_score: float, planned: Grasps, margin: float) -> tuple[Grasps, int]:
    """Put the held grasp first, with its score on the present cloud, unless another is better by more than the margin.

    It must be better on several clouds in a row: in a single image, noise may join a part of the table to the object. Grasps
    that are the held one again are left out.

    Returns:
        The grasps, and for how many clouds in a row the held one has been outdone.
    """
    grasp, before = held
    outdone = 0 if planned.score[0] <= held_score + margin else before + 1
    if outdone >= _OUTDONE:
        return planned, 0
    others = [other for other in planned if not is_twin(other, grasp)]
    return Grasps.of([replace(grasp, score=held_score, id=""), *others]), outdone


def is_twin(one: Grasp, other: Grasp) -> bool:
    """Return whether two grasps are the same on a plan: both contacts are nearer than the least distance of two of its grasps."""
    apart = np.linalg.norm(_contacts(one) - _contacts(other), axis=1)
    return bool((apart < APART_M).all())


def _contacts(grasp: Grasp) -> Float64:
    return np.stack([grasp.g1, grasp.g2])


def _measure(cloud: Cloud) -> _Place:
    """Centroid and mean deviation from it of the finite points.

    At a few pixels of an object's outline the camera measures the table in some images and the object in others. They
    change a standard deviation many times more than the mean deviation.
    """
    xyz = cloud.finite.astype(np.float64)
    if len(xyz) == 0:
        return np.full(3, np.inf), np.full(3, np.inf)
    centroid, columns, _ = centred_columns(xyz)
    return centroid, np.abs(columns).mean(axis=1)
