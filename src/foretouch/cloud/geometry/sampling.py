# SPDX-License-Identifier: Apache-2.0
"""A fixed number of points from a cloud of any size: at random, one a voxel, or each as far as can be from the others."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError

__all__ = ["SAMPLERS", "sample_indices"]

SAMPLERS = ("random", "voxel", "farthest")
_VOXEL_STEPS = 20  # halvings of the voxel's edge: 21 bits hold a cell's number, and float32 resolves little more


def sample_indices(
    xyz: npt.NDArray[np.floating], n: int, *, method: str = "random", rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Which points to take.

    A cloud of fewer than `n` points gives all of them, and some again, drawn at random.

    Args:
        xyz: (N, 3) floating [m], finite, N > 0.
        n: How many, > 0.
        method: "random" without replacement; "voxel", one point drawn from each cell of the coarsest grid
            that has at least `n` occupied cells; "farthest", each the farthest from those before it,
            the first drawn at random.
        rng: Source of randomness.

    Returns:
        (n,) int64, all different where N >= n.

    Raises:
        CloudError: If the cloud is empty or not finite, `n` is not positive, or the method is unknown.
    """
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) == 0:
        raise CloudError(f"xyz: shape {xyz.shape} is not (N, 3) with N > 0")
    if n < 1:
        raise CloudError(f"n: {n} points are not to be had")
    if method not in SAMPLERS:
        raise CloudError(f"method: {method!r} is none of {', '.join(SAMPLERS)}")
    if not np.isfinite(xyz).all():
        raise CloudError("xyz: holds points that are not finite")
    size = len(xyz)
    if size <= n:
        return np.concatenate([rng.permutation(size), rng.integers(0, size, n - size)]).astype(np.int64)
    if method == "farthest":
        return _farthest(xyz, n, int(rng.integers(size)))
    if method == "voxel":
        return _one_a_voxel(xyz, n, rng)
    return rng.choice(size, n, replace=False).astype(np.int64)


def _farthest(xyz: npt.NDArray[np.floating], n: int, first: int) -> npt.NDArray[np.int64]:
    """Farthest-point sampling; each coordinate lies contiguous, and no array is made in the loop."""
    columns = [np.ascontiguousarray(xyz[:, axis], np.float32) for axis in range(3)]
    nearest = np.full(len(xyz), np.inf, np.float32)
    squared, term = np.empty_like(nearest), np.empty_like(nearest)
    chosen = np.empty(n, np.int64)
    chosen[0] = first
    for k in range(1, n):
        latest = chosen[k - 1]
        squared[:] = 0.0
        for column in columns:
            np.subtract(column, column[latest], out=term)
            np.multiply(term, term, out=term)
            np.add(squared, term, out=squared)
        np.minimum(nearest, squared, out=nearest)
        nearest[latest] = -1.0  # points in one place are taken one after the other, never the same twice
        chosen[k] = nearest.argmax()
    return chosen


def _one_a_voxel(xyz: npt.NDArray[np.floating], n: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """One point of each voxel, thinned at random to n; filled up where points in one place share a voxel for good."""
    shuffled = rng.permutation(len(xyz))  # the first of a cell is then a random one of it
    points = xyz[shuffled].astype(np.float64)
    points -= points.min(axis=0)
    extent = float(points.max())
    first = np.zeros(1, np.int64)
    for step in range(_VOXEL_STEPS):
        cells = (
            np.floor(points * (2.0**step / extent)).astype(np.int64)
            if extent > 0.0
            else np.zeros_like(points, np.int64)
        )
        keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
        _, first = np.unique(keys, return_index=True)
        if len(first) >= n:
            return shuffled[rng.choice(first, n, replace=False)].astype(np.int64)
    rest = np.setdiff1d(np.arange(len(xyz)), first)
    chosen: npt.NDArray[np.int64] = shuffled[np.concatenate([first, rng.choice(rest, n - len(first), replace=False)])]
    return chosen
