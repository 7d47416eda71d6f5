# SPDX-License-Identifier: Apache-2.0
"""The object's main axis, its sign, and the coordinate that separates the two sides of the object.

After GeoGrasp (Zapata-Impata et al. 2019) and its public code, whose thresholds are kept.
"""

from dataclasses import dataclass

import numpy as np

from foretouch.cloud.geometry.pcl_filters import Voxels, cell_means, mean_neighbour_distance, voxel_grid
from foretouch.errors import CloudError
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.frame import object_frame, weigh_points
from foretouch.grasp.pose import hand_rotation
from foretouch.grasp.preprocessing import finite_points
from foretouch.types import Cloud, Float32, Float64, Grasps, Plane
from foretouch.types.grasps import contact_faults
from foretouch.types.rotations import are_absent

_TOP_VIEW = 0.9  # |n_z| of the table above which the camera looks down on it


@dataclass(frozen=True, eq=False)
class ObjectAxis:
    """Main axis and centroid of an object."""

    direction: Float64  # (3,) float64, unit length, sign fixed by the rule of `find_axis`
    centroid: Float64  # (3,) float64 [m], mean of the voxel points
    ratio: float  # middle over major eigenvalue, 0 ... 1; near 1 the object has no main axis
    side: int  # index of the coordinate whose extremes are the initial points: 0 for x, 1 for y, 2 for z
    cells: Voxels  # from which both were computed


def object_axis(cloud: Cloud, plane: Plane, config: GeoGraspConfig) -> tuple[Float64, Float64]:
    """Find the main axis and the centroid of an object: outlier filter, voxel grid, major eigenvector.

    Args:
        cloud: The object's points; those that are not finite are ignored.
        plane: The table, in the cloud's frame. Only its normal is used, regardless of its sign.
        config: Settings.

    Returns:
        (3,) float64 axis of unit length with the sign of `find_axis` (method `completed`: of `object_frame`), and (3,)
        float64 centroid [m].

    Raises:
        CloudError: If the points are too few, too far away, or all in one voxel.
    """
    if config.method == "completed":
        points = finite_points(cloud).in_canonical_order().downsampled(config)
        distance = mean_neighbour_distance(points.xyz, config.neighbours)
        centroid, direction = object_frame(weigh_points(points.xyz, distance, config), plane)
        return direction, centroid
    axis = find_axis(finite_points(cloud).downsampled(config).without_outliers(config), plane, config)
    return axis.direction, axis.centroid


def with_rotations(grasps: Grasps, cloud: Cloud, plane: Plane | None, config: GeoGraspConfig) -> Grasps:
    """Compute the rotations of grasps that have none, as the planner does: Z = g1 - g2, X = Z x the object's axis.

    Args:
        grasps: K grasps in the cloud's frame; those that have a rotation keep it.
        cloud: The object's points.
        plane: The table; without one nothing is computed, since it decides which way the axis points.
        config: Settings of `object_axis`.

    Raises:
        CloudError: As `object_axis`, if a rotation is missing.
    """
    if plane is None or not (missing := are_absent(grasps.rotation)).any():
        return grasps
    missing &= np.array([not fault for fault in contact_faults(grasps.g1, grasps.g2, grasps.rotation)])
    axis, _ = object_axis(cloud, plane, config)
    rotation = grasps.rotation.copy()
    for k in np.flatnonzero(missing).tolist():
        rotation[k] = hand_rotation(grasps.g1[k], grasps.g2[k], axis)
    return grasps.replace(rotation=rotation)


def find_axis(xyz: Float32, plane: Plane, config: GeoGraspConfig) -> ObjectAxis:
    """Find the main axis of filtered points.

    The eigensolver leaves the sign open, and GeoGrasp's rule does not determine it in every side view. The axis is
    therefore first turned so that its largest component is negative, and the rule is applied to that.

    Args:
        xyz: (N, 3) float32 [m], finite, without outliers.
        plane: The table.
        config: Settings.

    Raises:
        CloudError: If all points are in one voxel.
    """
    cells = voxel_grid(xyz, config.voxel_m)
    voxels = cell_means(xyz, cells)
    if len(voxels) < 2:
        raise CloudError(f"xyz: {len(xyz)} points in {len(voxels)} voxel of {config.voxel_m} m have no axis")
    centroid = voxels.mean(axis=0)
    offset = voxels - centroid
    values, vectors = np.linalg.eigh(offset.T @ offset)
    direction = vectors[:, 2] / np.linalg.norm(vectors[:, 2])
    if direction[np.argmax(np.abs(direction))] > 0.0:
        direction = -direction
    if _is_flipped(direction, plane):
        direction = -direction
    return ObjectAxis(direction, centroid, float(max(values[1], 0.0) / values[2]), _side(direction, plane), cells)


def _side(axis: Float64, plane: Plane) -> int:
    if abs(plane.normal[2]) > _TOP_VIEW:
        return 1 if abs(axis[0]) > 0.5 else 0
    return 2 if abs(float(axis @ plane.normal)) < 0.55 and abs(axis[2]) < 0.45 else 0


def _is_flipped(axis: Float64, plane: Plane) -> bool:
    """GeoGrasp's rule for the sign, which keeps the hand's X from jumping between similar views."""
    x, y, z = axis
    if abs(plane.normal[2]) > _TOP_VIEW:
        if abs(z) < 0.25:
            return bool((abs(x) > 0.5 and x > 0) or (abs(x) < 0.5 and y < 0))
        return bool(abs(z) > 0.25 and z > 0)
    upright = abs(float(axis @ plane.normal))
    if upright > 0.45 and y > 0:
        return True
    if upright < 0.55:
        return bool((abs(z) <= 0.1 and x > 0) or (abs(z) > 0.1 and x != 0 and y > 0 and z < 0))
    return False
