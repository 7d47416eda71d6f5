# SPDX-License-Identifier: Apache-2.0
"""Plain numbers that describe an object and a grasp: what the trees are given instead of a cloud."""

from __future__ import annotations

from typing import Final

import numpy as np

from foretouch.types import Float64, GraspSample

__all__ = ["FEATURE_NAMES", "geometry_features"]

_CONTACT_RADIUS_M: Final = 0.02  # about the size of a fingertip's pad
_CONTACT_NAMES: Final = ("count", "spread_1", "spread_2", "spread_3", "gap", "dx", "dy", "dz")

FEATURE_NAMES: Final = (
    *("x", "y", "z"),
    *("extent_x", "extent_y", "extent_z"),
    *("spread_1", "spread_2", "spread_3"),
    *("radius", "log_points"),
    *("g1_x", "g1_y", "g1_z", "g2_x", "g2_y", "g2_z"),
    *("width", "offset"),
    *(f"r{i}{j}" for i in range(3) for j in range(3)),
    *(f"{contact}_{name}" for contact in ("g1", "g2") for name in _CONTACT_NAMES),
)


def geometry_features(sample: GraspSample) -> Float64:
    """(len(FEATURE_NAMES),) float64: lengths in metres, camera frame; contacts relative to the centroid.

    Where no point is near a contact its spreads and offset are 0 and its count says so.
    """
    cloud = sample.cloud.take(np.asarray(np.isfinite(sample.cloud.xyz).all(axis=-1), np.bool_))
    xyz = cloud.xyz.astype(np.float64)
    centroid = xyz.mean(axis=0)
    centred = xyz - centroid
    grasp = sample.grasp
    radius = float(np.linalg.norm(centred, axis=1).max())
    return np.concatenate(
        [
            centroid,
            np.ptp(xyz, axis=0),
            _spreads(centred),
            [radius, np.log(len(xyz))],
            grasp.g1 - centroid,
            grasp.g2 - centroid,
            [grasp.width_m, float(np.linalg.norm(grasp.midpoint - centroid))],
            grasp.rotation.reshape(-1),
            _contact(xyz, grasp.g1),
            _contact(xyz, grasp.g2),
        ]
    )


def _contact(xyz: Float64, contact: Float64) -> Float64:
    offset = xyz - contact
    distance = np.linalg.norm(offset, axis=1)
    near = offset[distance < _CONTACT_RADIUS_M]
    if len(near) == 0:
        return np.array([0.0, 0.0, 0.0, 0.0, distance.min(), 0.0, 0.0, 0.0])
    mean = near.mean(axis=0)
    return np.concatenate([[len(near) / len(xyz)], _spreads(near - mean), [distance.min()], mean])


def _spreads(centred: Float64) -> Float64:
    """(3,) standard deviations along the principal axes [m], ascending."""
    values = np.linalg.eigvalsh(centred.T @ centred / len(centred))
    return np.asarray(np.sqrt(np.maximum(values, 0.0)), np.float64)
