# SPDX-License-Identifier: Apache-2.0
"""Arithmetic of 40 digits for references of kernels, and inputs whose condition is chosen."""

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt

mpmath.mp.dps = 40

Float64 = npt.NDArray[np.float64]
Exact = Any  # an array of mpmath numbers, dtype object; operators and products work on it

EPS = float(np.finfo(np.float64).eps)


def span(t: float, low: float, high: float) -> float:
    """The number at t on a geometric scale from `low` to `high`."""
    return float(low * (high / low) ** t)


def exact(values: npt.ArrayLike) -> Exact:
    """The same numbers as mpmath numbers; those that are already stay."""
    array = np.asarray(values)
    if array.dtype == object:
        return array
    return _apply(mpmath.mpf, array.astype(np.float64).astype(object))


def real(values: Exact) -> Float64:
    """Rounded to float64."""
    return np.asarray(_apply(float, np.asarray(values, object)), np.float64)


def _apply(function: Callable[[Any], Any], values: npt.ArrayLike) -> Exact:
    return np.asarray(np.frompyfunc(function, 1, 1)(values), object)


def sqrt(values: Exact) -> Exact:
    """Of each number."""
    return _apply(mpmath.sqrt, values)


def norm(vectors: Exact) -> Exact:
    """Length of the vectors (..., 3)."""
    return sqrt((vectors * vectors).sum(axis=-1))


def gap(computed: npt.ArrayLike, reference: Exact) -> float:
    """Largest |computed - reference|."""
    return float(np.max(np.abs(exact(computed) - exact(reference))))


def gap_up_to_sign(computed: npt.ArrayLike, reference: Exact) -> float:
    """`gap` of the nearer of a direction and its opposite."""
    return min(gap(computed, reference), gap(computed, -exact(reference)))


def eigen(matrix: Exact) -> tuple[Exact, Exact]:
    """Eigenvalues, ascending, and eigenvectors as columns of a symmetric matrix."""
    values, vectors = mpmath.eigsy(mpmath.matrix(exact(matrix).tolist()))
    size = len(values)
    columns = [[vectors[i, j] for j in range(size)] for i in range(size)]
    order = sorted(range(size), key=lambda k: values[k])
    return np.array([values[k] for k in order], object), np.array(columns, object)[:, order]


def covariance(points: Exact, weight: Exact | None = None) -> tuple[Exact, Exact]:
    """Mean and covariance (divided by the sum of the weights) of points (N, 3)."""
    weight = exact(np.ones(len(points))) if weight is None else weight
    total = weight.sum()
    mean = (weight[:, None] * points).sum(axis=0) / total
    moved = points - mean
    return mean, (moved * weight[:, None]).T @ moved / total


def spread_points(rng: np.random.Generator, n: int, spreads: npt.ArrayLike) -> Float64:
    """(n, 3) uncorrelated points with these standard deviations along x, y and z, and mean zero, up to rounding."""
    points = rng.uniform(-1.0, 1.0, (n, 3))
    points -= points.mean(axis=0)
    return np.asarray(points @ np.linalg.inv(np.linalg.cholesky(np.cov(points.T, bias=True))).T * spreads)


def far_or_round(t: float, rng: np.random.Generator, farthest: float) -> tuple[float, float]:
    """Distance, 0.3 m to `farthest`, and relative difference of two spreads, 0.5 to 1e-6: one of the two grows with t."""
    return (span(t, 0.3, farthest), 0.5) if rng.random() < 0.5 else (0.3, span(t, 0.5, 1e-6))


def rotation(rng: np.random.Generator) -> Float64:
    """A random rotation, rounded to float64."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.linalg.det(q)))


def float32_cloud(points: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Rounded as clouds are: the kernel and its reference start from the rounded points."""
    return np.ascontiguousarray(points, np.float32)
