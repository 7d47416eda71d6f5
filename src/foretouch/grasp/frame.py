# SPDX-License-Identifier: Apache-2.0
"""An object's points with weights, and its own frame, with no decision that a small change of the cloud can flip.

GeoGrasp (Zapata-Impata et al. 2019) decides by hard limits whether a point is an outlier, and the sign of the axis by the
camera's frame. Here outliers fade out around the limit of the filter, points weigh by the area that they cover, and the
sign of the axis follows the object's own asymmetry.
"""

from dataclasses import dataclass

import numpy as np

from foretouch.cloud.geometry.columns import median
from foretouch.errors import CloudError
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.pose import cross
from foretouch.types import Float32, Float64, Floating, Plane

_ISOLATED = 20.0  # medians of the distance to the neighbours beyond which a point is isolated; recorded ones reach 10
_FADE = 0.25  # standard deviations on either side of the outlier limit, over which points fade out
_UPRIGHT = (0.45, 0.65)  # |axis · table normal| over which the sides turn from across the table to across the view
_EPSILON = 1e-9  # floor of a divisor
# What an object without a main axis or without asymmetry leaves open follows one direction of the camera's frame.
PREFERRED = np.array([0.95, 0.3, 0.08])  # mostly the image's x; of length 1 within 0.1 %
_AXIS_BIAS = 0.01  # of the major eigenvalue, added along it
_SIGN_BIAS = 0.01  # of the normalised third moment; 0.1 mm of noise on a recorded cloud changes it by 0.002


@dataclass(frozen=True, eq=False)
class WeightedPoints:
    """The points of an object with their weights."""

    xyz: Float64  # (N, 3) float64 [m]
    inlier: Float64  # (N,) float64, 0 for an outlier ... 1
    area: Float64  # (N,) float64, proportional to the surface that each point covers, 0 for an outlier
    n_isolated: int  # points far from all others


def smoothstep(values: Floating, low: float, high: float) -> Float64:
    """Return 0 below `low`, 1 above `high`, and between them what has a continuous slope.

    Args:
        values: (...,) floating.
        low: Where it begins to rise.
        high: Where it ends.
    """
    t = np.minimum(np.maximum((np.asarray(values, np.float64) - low) / max(high - low, 1e-300), 0.0), 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), np.float64)


def weigh_points(xyz: Float32, neighbour_distance: Float32, config: GeoGraspConfig) -> WeightedPoints:
    """Weigh the points by their mean distance to their neighbours.

    Isolated points do not count at all, since a single one far away would move the outlier limit for all others.

    Args:
        xyz: (N, 3) float32 [m], finite, in an order that does not depend on the input's.
        neighbour_distance: (N,) float32 [m], see `mean_neighbour_distance`.
        config: Settings.
    """
    d = neighbour_distance.astype(np.float64)
    isolated = d > _ISOLATED * max(median(d) if len(d) else 0.0, _EPSILON)
    near = d[~isolated] if isolated.any() else d
    spread = float(near.std(ddof=1)) if len(near) > 1 else 0.0
    limit = float(near.mean()) + config.outlier_deviations * spread
    fade = _FADE * spread + 1e-9
    inlier = np.where(isolated, 0.0, 1.0 - smoothstep(d, limit - fade, limit + fade))
    return WeightedPoints(xyz.astype(np.float64, order="C"), inlier, inlier * d * d, int(np.count_nonzero(isolated)))


def object_frame(points: WeightedPoints, plane: Plane) -> tuple[Float64, Float64]:
    """Return (3,) centroid of the visible surface [m], and (3,) main axis.

    The sign of the axis follows the object's asymmetry along it and across it.

    Across is the table's normal x the axis, and for an upright object the axis x the direction of view; it changes
    its sign with the axis. Of the two signs, that with the larger sum of the third moments along both directions is
    taken. A small constant preference for one direction of the camera's frame is added to the second and the third
    moments: it decides where the object is as round, or as symmetric, as the noise.

    Raises:
        CloudError: If the points coincide.
    """
    total = float(points.area.sum())
    if not total > 0.0:
        raise CloudError(f"xyz: {len(points.xyz)} points at one place have no axis")
    centroid = points.area @ points.xyz / total
    offset = points.xyz - centroid
    covariance = (offset * points.area[:, None]).T @ offset / total
    largest = float(np.linalg.eigvalsh(covariance)[2])
    _, vectors = np.linalg.eigh(covariance + _AXIS_BIAS * largest * np.outer(PREFERRED, PREFERRED))
    axis = vectors[:, 2]
    up = np.asarray(plane.normal, np.float64)
    if up @ centroid > 0.0:
        up = -up
    lying = cross(up, axis)
    upright = cross(axis, centroid / max(float(np.linalg.norm(centroid)), _EPSILON))
    share = float(smoothstep(np.array(abs(up @ axis)), *_UPRIGHT))
    across = (1.0 - share) * lying + share * upright
    if np.linalg.norm(across) < 1e-6:
        across = vectors[:, 1]
    across -= (across @ axis) * axis
    across /= np.linalg.norm(across)
    weight = points.area / total
    skew = sum(_third_moment(weight, along) for along in (offset @ axis, offset @ across))
    if skew + _SIGN_BIAS * (across @ PREFERRED) < 0.0:
        axis = -axis
    return centroid, axis


def _third_moment(weight: Float64, along: Float64) -> float:
    """Skewness of weighted coordinates with mean zero."""
    squared = along * along
    return float((weight * squared) @ along / max(float(weight @ squared), 1e-300) ** 1.5)
