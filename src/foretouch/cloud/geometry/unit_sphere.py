# SPDX-License-Identifier: Apache-2.0
"""The frame in which the touch models see an object: its centroid at the origin, its farthest point at distance one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError
from foretouch.types import Float64, Grasp

__all__ = ["UnitSphereFrame"]

_LEAST_SCALE_M = 1e-6  # a cloud smaller than this is one point and the rounding of float32


@dataclass(frozen=True, eq=False)
class UnitSphereFrame:
    """Moves a cloud and its grasp together to the unit sphere and back (P1, section III.A).

    Attributes:
        centre: (3,) float64 [m], centroid of the points it was fitted to.
        scale: Distance of the farthest of them [m].
    """

    centre: Float64
    scale: float

    @classmethod
    def fit(cls, xyz: npt.NDArray[np.floating]) -> Self:
        """The frame of a cloud.

        Args:
            xyz: (N, 3) floating [m], finite, N > 0.

        Raises:
            CloudError: If there is no point, one is not finite, or all are in one place.
        """
        points = np.asarray(xyz, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
            raise CloudError(f"xyz: shape {points.shape} is not (N, 3) with N > 0")
        if not np.isfinite(points).all():
            raise CloudError("xyz: holds points that are not finite")
        centre = points.mean(axis=0)
        scale = float(np.sqrt(((points - centre) ** 2).sum(axis=1).max()))
        if scale < _LEAST_SCALE_M:
            raise CloudError(f"xyz: all {len(points)} points are in one place, {centre.tolist()}")
        return cls(centre, scale)

    def apply_points(self, points: npt.NDArray[np.floating]) -> Float64:
        """(..., 3) [m] to the unit sphere, float64."""
        return (np.asarray(points, np.float64) - self.centre) / self.scale

    def invert_points(self, points: npt.NDArray[np.floating]) -> Float64:
        """(..., 3) of the unit sphere back to [m], float64."""
        return np.asarray(points, np.float64) * self.scale + self.centre

    def apply_grasp(self, grasp: Grasp) -> Grasp:
        """The grasp as it stands to the moved cloud: contacts move; the axes of the frames are parallel, so R stays."""
        return replace(grasp, g1=self.apply_points(grasp.g1), g2=self.apply_points(grasp.g2))

    def invert_grasp(self, grasp: Grasp) -> Grasp:
        """The reverse of `apply_grasp`."""
        return replace(grasp, g1=self.invert_points(grasp.g1), g2=self.invert_points(grasp.g2))
