# SPDX-License-Identifier: Apache-2.0
"""What the points of an object show of its shape."""

from typing import Final

import numpy as np

from foretouch.cloud.geometry.columns import centred_columns, distances
from foretouch.errors import CloudError
from foretouch.types import Float64

_MINIMUM_POINTS: Final = 8


def usable_points(xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> Float64:
    """(M, 3) float64: the finite points of a cloud; raises `CloudError` if they show no shape."""
    points = np.asarray(xyz, np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        points = points[np.isfinite(points).all(axis=1)]
    if len(points) < _MINIMUM_POINTS:
        raise CloudError(f"cloud: {len(points)} finite points are fewer than {_MINIMUM_POINTS}")
    if (points[-1] == points[0]).all() and (points == points[0]).all():
        raise CloudError(f"cloud: all {len(points)} finite points are in one place")
    return points


def principal_axes(covariance: Float64) -> tuple[Float64, Float64]:
    """(…, 3) standard deviations along the principal axes, ascending, and the axes as columns of (…, 3, 3)."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0)), axes


def object_sizes(xyz: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> Float64:
    """(8,) float64 of (N, 3) points [m]: extents along x, y, z, principal deviations, radius, logarithm of their number.

    Raises:
        CloudError: If fewer than eight points are finite, or all are at one position.
    """
    points = usable_points(xyz)
    _, columns, covariance = centred_columns(points)
    deviations, _ = principal_axes(covariance)
    return np.concatenate([np.ptp(points, axis=0), deviations, [distances(columns).max(), np.log(len(points))]])
