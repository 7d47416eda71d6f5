# SPDX-License-Identifier: Apache-2.0
"""Mean, distances and quantiles of points by columns: NumPy's own results to the last bit, several times as fast.

Operations on rows of three numbers take several times as long as on three contiguous columns.
"""

from collections.abc import Sequence

import numpy as np

from foretouch.kernels import Kernel
from foretouch.types import Float32, Float64, Floating, Index

_centre_points = Kernel("centre_points")
_bounds = Kernel("bounds")


def centred_columns(points: Float64) -> tuple[Float64, Float64, Float64]:
    """Return (3,) mean of (N, 3) points, N > 0, (3, N) their coordinates from it, and (3, 3) the covariance of these.

    Equal to `points.mean(axis=0)` and the difference from it.
    """
    centre = np.empty(3)
    columns = np.empty((3, len(points)))
    covariance = np.empty((3, 3))
    _centre_points(np.ascontiguousarray(points), len(points), centre, columns, covariance)
    return centre, columns, covariance


def bounds(points: Float32) -> tuple[Float64, Float64]:
    """Return (3,) smallest and (3,) largest coordinates of the finite ones of (N, 3) points; inf and -inf without one."""
    low, high = np.empty(3), np.empty(3)
    _bounds(np.ascontiguousarray(points), len(points), low, high)
    return low, high


def distances(columns: Float64) -> Float64:
    """Return (N,) distances of (3, N) coordinates from the origin."""
    x, y, z = columns
    return np.asarray(np.sqrt(x * x + y * y + z * z), np.float64)


def median(values: Floating) -> float:
    """Return the median of (N,) values, N > 0, none of them NaN: equal to `np.median`, in a third of the time."""
    middle = [(len(values) - 1) // 2, len(values) // 2]
    low, high = np.partition(values, middle)[middle]
    return float((low + high) / values.dtype.type(2.0))


def spread(n: int, count: int) -> Index:
    """Return (count,) of n places, count > 1, evenly spread with the first and the last: equal to `np.linspace` as integers, in a third of the time."""
    places = (np.arange(count) * ((n - 1.0) / (count - 1.0))).astype(np.intp)
    places[-1] = n - 1
    return places


def quantiles(values: Float64, shares: Sequence[float]) -> list[float]:
    """Return quantiles of (N,) values, N > 0, equal to `np.quantile`."""
    ordered, last = np.sort(values), len(values) - 1  # the sort is vectorised; a partition by several indices is not
    result = []
    for share in shares:
        at = share * last
        k = int(at)
        low = float(ordered[k])
        high = float(ordered[min(k + 1, last)])
        t = at - k
        result.append(high - (high - low) * (1.0 - t) if t >= 0.5 else low + (high - low) * t)
    return result
