# SPDX-License-Identifier: Apache-2.0
"""The original GeoGrasp's score of any two contacts, at full resolution and in the scales of its candidates."""

import numpy as np

from foretouch.cloud.geometry.pcl_filters import normals_and_curvature
from foretouch.errors import CloudError
from foretouch.grasp.axis import find_axis
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.preprocessing import finite_points
from foretouch.grasp.ranking import SurfacePoints, _ScaledSide, _two_rankings, contact_sides, find_grasp_plane
from foretouch.types import Cloud, Float64, Plane

_ROUND = 0.9  # middle over major eigenvalue, above which the axis is arbitrary
_CONTACT_M = 0.00625  # half a voxel: over which normal and curvature of a contact are averaged [m]


class OriginalScore:
    """Scores any two contacts on an object's points [m]; grasps of any method and setting are compared by it.

    A `CloudError` if the original finds no grasp plane.
    """

    def __init__(self, cloud: Cloud, plane: Plane) -> None:
        config = GeoGraspConfig(max_points=0)
        self._xyz = finite_points(cloud).downsampled(config).without_outliers(config)
        axis = find_axis(self._xyz, plane, config)
        self.has_axis = axis.ratio < _ROUND  # on a ball it is arbitrary, and with it the score
        self._plane = find_grasp_plane(self._xyz, axis.centroid, axis.direction, axis.side, config.slab_half_width_m)
        self._sides = [
            _ScaledSide(side.candidates, self._plane, axis.centroid)
            for side in contact_sides(self._xyz, self._plane, config)
        ]

    def __call__(self, pair: Float64) -> tuple[float, bool]:
        """Return the score of (2, 3) contacts [m], NaN if undefined, and whether both rankings reach their minimum of 1."""
        across = self._xyz[self._plane.second] - self._xyz[self._plane.first]
        first, second = (pair if (pair[1] - pair[0]) @ across >= 0.0 else pair[::-1])[:, None]
        a, b = self._surface(first), self._surface(second)
        (_, pd_a, k_a), (_, pd_b, k_b) = self._sides[0](a), self._sides[1](b)
        unit = (second - first) / np.linalg.norm(second - first)
        r1, r2 = _two_rankings(unit, self._plane.normal, (a.normal, b.normal), (pd_a, pd_b), (k_a, k_b))
        return float(1.5 * r1[0] + r2[0]), bool(r1[0] >= 1.0 and r2[0] >= 1.0)

    def _surface(self, contact: Float64) -> SurfacePoints:
        squared = ((self._xyz - contact) ** 2).sum(axis=1)
        near = np.flatnonzero(squared <= max(_CONTACT_M**2, float(squared.min())))
        normals, curvature = normals_and_curvature(self._xyz, near)
        mean = normals.mean(axis=0)
        return SurfacePoints(contact, (mean / np.linalg.norm(mean))[None], np.array([curvature.mean()]))


def original_score(cloud: Cloud, plane: Plane) -> OriginalScore | None:
    """Prepare the original's score of an object; None if the original finds no grasp plane.

    Args:
        cloud: The object's points.
        plane: The table.
    """
    try:
        return OriginalScore(cloud, plane)
    except CloudError:
        return None
