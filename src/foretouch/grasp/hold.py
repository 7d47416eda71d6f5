# SPDX-License-Identifier: Apache-2.0
"""Keep the best grasp of an object from cloud to cloud of a stream."""

from dataclasses import dataclass, replace

import numpy as np

from foretouch.types import Cloud, Float64, Grasp


@dataclass(frozen=True, eq=False)
class _Held:
    """A grasp, and the object as it was when the grasp was planned."""

    centroid: Float64  # (3,) float64 [m]
    spread: Float64  # (3,) float64, standard deviation of x, y, z [m]
    grasp: Grasp


class GraspHold:
    """The last best grasp of each object of a stream.

    Objects have no identity from cloud to cloud: an object is the same if position and size are within a tolerance of
    those for which its grasp was planned, so that small motions do not add up.

    Args:
        tolerance_m: Largest change of any coordinate of position and size [m].
    """

    def __init__(self, tolerance_m: float) -> None:
        self._tolerance_m = tolerance_m
        self._held: list[_Held] = []
        self._fresh: list[_Held] = []

    def find(self, cloud: Cloud) -> Grasp | None:
        """The grasp that was planned on this object, if the object is still the same."""
        found = self._find(_measure(cloud))
        return None if found is None else found.grasp

    def remember(self, cloud: Cloud, grasp: Grasp) -> None:
        """Keep the best grasp of an object for the next cloud."""
        now = _measure(cloud)
        before = self._find(now)
        kept = before is not None and np.array_equal([before.grasp.g1, before.grasp.g2], [grasp.g1, grasp.g2])
        self._fresh.append(before if before is not None and kept else _Held(*now, grasp))

    def next_cloud(self) -> None:
        """Forget the objects that the last cloud did not hold."""
        self._held, self._fresh = self._fresh, []

    def _find(self, now: tuple[Float64, Float64]) -> _Held | None:
        for one in self._held:
            change = np.abs(np.concatenate([one.centroid - now[0], one.spread - now[1]])).max()
            if change <= self._tolerance_m:
                return one
        return None


def held_or_new(held: Grasp, held_score: float, new: Grasp, margin: float) -> Grasp:
    """The held grasp with its score on the present cloud, unless the new one is better by more than the margin."""
    return new if not new.score <= held_score + margin else replace(held, score=held_score, id="")


def _measure(cloud: Cloud) -> tuple[Float64, Float64]:
    """Centroid and standard deviation of the finite points."""
    xyz = cloud.xyz.reshape(-1, 3).astype(np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    if len(xyz) == 0:
        return np.full(3, np.inf), np.full(3, np.inf)
    return xyz.mean(axis=0), xyz.std(axis=0)
