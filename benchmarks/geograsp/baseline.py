# SPDX-License-Identifier: Apache-2.0
"""A straightforward GeoGrasp with SciPy's tree only: normals at all points."""

import numpy as np
from scipy.spatial import cKDTree

from foretouch.cloud.geometry.pcl_filters import voxel_grid
from foretouch.grasp import GeoGraspConfig
from foretouch.grasp.axis import find_axis
from foretouch.grasp.ranking import ContactSide, Ranking, SurfacePoints, _contact_radius, find_grasp_plane, rank_pairs
from foretouch.types import Float32, Float64, Plane


def inliers(xyz: Float32, config: GeoGraspConfig) -> Float32:
    """The filtered cloud, by 50 neighbours of every point from the tree."""
    distance, _ = cKDTree(xyz).query(xyz, config.neighbours + 1)
    mean = distance[:, 1:].mean(axis=1).astype(np.float32).astype(np.float64)
    return xyz[mean <= mean.mean() + config.outlier_deviations * mean.std(ddof=1)]


def normals_everywhere(xyz: Float32, radius_m: float) -> tuple[Float64, Float64]:
    """(N, 3) normals and (N,) curvature of all points."""
    normals, curvature = np.full((len(xyz), 3), np.nan), np.full(len(xyz), np.nan)
    double = xyz.astype(np.float64)
    for i, near in enumerate(cKDTree(xyz).query_ball_point(xyz, radius_m)):
        if len(near) < 3:
            continue
        offset = double[near] - double[near].mean(axis=0)
        values, vectors = np.linalg.eigh(offset.T @ offset)
        normals[i] = vectors[:, 0] * (-1.0 if vectors[:, 0] @ double[i] > 0 else 1.0)
        curvature[i] = values[0] / values.sum()
    return normals, curvature


def plan(xyz: Float32, plane: Plane, config: GeoGraspConfig) -> tuple[Ranking, tuple[ContactSide, ContactSide]]:
    """The ranking, and both sides to which its indices refer."""
    xyz = inliers(xyz, config)
    normals, curvature = normals_everywhere(xyz, config.normal_radius_m)
    axis = find_axis(xyz, plane, config)
    grasp_plane = find_grasp_plane(xyz, axis.centroid, axis.direction, axis.side, config.slab_half_width_m)
    tree = cKDTree(xyz)
    sides = []
    for initial in (grasp_plane.first, grasp_plane.second):
        near = np.sort(tree.query_ball_point(xyz[initial], _contact_radius(grasp_plane.width_m, config)))
        columns = np.column_stack([xyz[near].astype(np.float64), normals[near], curvature[near]])
        mean = voxel_grid(xyz[near], config.voxel_m).mean(columns)
        unit = mean[:, 3:6] / np.linalg.norm(mean[:, 3:6], axis=1, keepdims=True)
        candidates = SurfacePoints(mean[:, :3], unit, mean[:, 6])
        point = SurfacePoints(xyz[[initial]].astype(np.float64), normals[[initial]], curvature[[initial]])
        sides.append(ContactSide(candidates, point, len(near)))
    both = (sides[0], sides[1])
    return rank_pairs(both, grasp_plane, axis.centroid), both
