# SPDX-License-Identifier: Apache-2.0
"""What the kernels of `neighbours.c`, `flying.c`, `voxels.c` and `order.c` compute, in NumPy."""

from collections.abc import Iterator
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def mean_neighbour_distance(xyz, k: int, query=None) -> Array:
    k = min(k, len(xyz) - 1)
    blocks = _squared(xyz if query is None else xyz[query], xyz)
    means = [np.sqrt(np.partition(block, k)[:, : k + 1]).sum(axis=1, dtype=np.float64) / k for block in blocks]
    return np.concatenate(means).astype(np.float32)


def summed_moments(near, points, radius_m: float) -> Array:
    """(Q, 10): 1, x, y, z from the first of them, and their products, of the neighbours strictly within the radius."""
    moments, limit = _moments(near), np.float32(radius_m) ** 2
    return np.concatenate([(one < limit).astype(np.float64) @ moments for one in _squared(points, near)])


def normals_and_curvature(xyz, query, radius_m: float = 0.03) -> tuple[Array, Array]:
    """Of the eigenvectors of the neighbours' covariance; NaN where the neighbours span no plane."""
    c, spans = _covariance(summed_moments(xyz, xyz[query], radius_m))
    values, vectors = np.linalg.eigh(c)
    normal = vectors[:, :, 0]
    normal = np.where(np.einsum("ij,ij->i", normal, xyz[query].astype(np.float64))[:, None] > 0.0, -normal, normal)
    with np.errstate(invalid="ignore"):
        curvature = np.maximum(values[:, 0], 0.0) / values.sum(axis=1)
    return np.where(spans[:, None], normal, np.nan), np.where(spans, curvature, np.nan)


def count_without_normal(xyz, radius_m: float = 0.03) -> int:
    return np.count_nonzero(~_covariance(summed_moments(xyz, xyz, radius_m))[1])


def flying_points(xyz, some, radius: float, gap_m: float, slope: float, share: float, support: float) -> Array:
    z, rays = xyz[:, 2], xyz[:, :2] / xyz[:, 2:]
    found = np.zeros(len(some), np.bool_)
    for k, i in enumerate(some):
        apart = ((rays - rays[i]) ** 2).sum(axis=1)
        near = (apart <= np.float32(radius) ** 2) & (np.arange(len(xyz)) != i)
        deeper = (z - z[i])[near]
        close = deeper**2 <= np.maximum(np.float32(slope**2) * z[i] * z[i] * apart[near], np.float32(gap_m**2))
        side = max(np.count_nonzero(~close & (deeper > 0.0)), np.count_nonzero(~close & (deeper < 0.0)))
        found[k] = near.sum() >= 5 and side >= share * near.sum() and close.sum() <= support
    return found


def voxels(xyz, leaf_m: float) -> tuple[Array, Array]:
    """Cell of each point, ordered by z, then y, then x, and the points of each cell."""
    ijk = np.floor(xyz * (np.float32(1.0) / np.float32(leaf_m)))
    _, cell, counts = np.unique(ijk[:, ::-1] + np.float32(0.0), axis=0, return_inverse=True, return_counts=True)
    return cell.reshape(-1), counts


def cell_means(values, cell, counts) -> Array:
    sums = np.zeros((len(counts), values.shape[1]))
    np.add.at(sums, cell, values)
    return sums / counts[:, None]


def canonical_order(xyz) -> Array:
    return np.lexsort(xyz.T[::-1])


def _squared(points, others) -> Iterator[Array]:
    """Squared distances of blocks of points from the others in float32, summed in the order x, y, z."""
    for block in np.array_split(points, len(points) // 100 + 1):
        x, y, z = (np.square(a[:, None] - b) for a, b in zip(block.T, np.ascontiguousarray(others.T), strict=True))
        yield x + y + z


def _moments(xyz) -> Array:
    x, y, z = (xyz.astype(np.float64) - xyz[0].astype(np.float64)).T
    return np.column_stack([np.ones(len(xyz)), x, y, z, x * x, x * y, x * z, y * y, y * z, z * z])


def _covariance(sums) -> tuple[Array, Array]:
    """(Q, 3, 3), and whether three of the points are not on one line."""
    mean = sums / np.maximum(sums[:, :1], 1.0)
    c = mean[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) - mean[:, 1:4, None] * mean[:, None, 1:4]
    trace = np.trace(c, axis1=1, axis2=2)
    products = (trace * trace - np.einsum("qij,qij->q", c, c)) / 2.0  # of two eigenvalues each: 0 on a line
    return c, (sums[:, 0] >= 3) & (products > 1e-8 * trace * trace)
