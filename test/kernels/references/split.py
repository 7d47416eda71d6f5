# SPDX-License-Identifier: Apache-2.0
"""What `split_clusters` of `split.c` computes, in NumPy and SciPy and double precision, for convex objects of one image.

It has every stage but the rules for hollow, hidden and concentric parts; those have tests of their own.
"""

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = np.ndarray[Any, Any]
_STEP, _FULL, _REACH, _SLOPE, _LIKE = 2.0, 0.7, 2, 4.0, 0.005


class Split:
    """Cells of a window and what is found of them.

    Args:
        xyz: (H, W, 3) points.
        labels: (H, W) clusters, 0 for none.
        solid: (H, W) pixels with a reliable depth.
        k: Pixels of a cell's side.
        settings: Angle [rad], step [m], smallest part [m2], plane (4), pitch of the cells.
    """

    def __init__(self, xyz: Array, labels: Array, solid: Array, k: int, settings: Array) -> None:
        self.k, self.xyz, self.labels = k, xyz.astype(np.float64), labels
        self.angle, self.step, self.least_m2, self.pitch = settings[0], settings[1], settings[2], settings[7]
        h, w = (-(-size // k) for size in labels.shape)
        self.p, self.d, self.cluster = np.full((h, w, 3), np.nan), np.full((h, w), np.nan), np.zeros((h, w), int)
        for at in np.ndindex(h, w):
            self._make_cell(at, solid)
        ends = ((slice(None), slice(1, None)), (slice(1, None), slice(None)))
        starts = ((slice(None), slice(None, -1)), (slice(None, -1), slice(None)))
        self.bends = np.full((h, w, 2), np.nan)
        for axis, (end, start) in enumerate(zip(ends, starts, strict=True)):
            both = (self.cluster[start] > 0) & (self.cluster[end] > 0)
            self.bends[(*start, axis)] = np.where(both, self._steps(axis) * _STEP, np.nan)
        self.n = np.array([[self._normal((i, j)) for j in range(w)] for i in range(h)])
        self.bends = np.array([[[self._bend((i, j), axis) for axis in (0, 1)] for j in range(w)] for i in range(h)])

    def _make_cell(self, at: tuple[int, int], solid: Array) -> None:
        window = tuple(slice(i * self.k, (i + 1) * self.k) for i in at)
        here, z, labels = solid[window].astype(bool), self.xyz[window][..., 2], self.labels[window]
        if not here.any():
            return
        first = np.argmax(here.any(axis=1))
        middle = tuple((2 * (i * self.k) + n) // 2 - i * self.k for i, n in zip(at, here.shape, strict=True))
        chosen = middle if here[middle] else (first, np.flatnonzero(here[first])[-1])
        self.cluster[at] = labels[chosen]
        if self.cluster[at]:
            use = here & (labels == labels[chosen]) & (np.abs(z - z[chosen]) < self.step)
            points = self.xyz[window][use]
            self.d[at] = (1.0 / points[:, 2]).mean()
            self.p[at] = (points / points[:, 2:]).mean(axis=0) / self.d[at]

    def _steps(self, axis: int) -> Array:
        """Whether the depth jumps between neighbours along an axis (0: to the right)."""
        turn = (lambda a: a) if axis == 0 else (lambda a: np.swapaxes(a, 0, 1))
        p, d, cluster = turn(self.p), turn(self.d), turn(self.cluster)
        by, same = np.diff(d, axis=1), np.diff(cluster, axis=1) == 0
        alone = np.full((len(d), 1), np.nan)
        linked = np.where(same, by, np.nan)
        left = np.abs(by - np.hstack([alone, linked[:, :-1]]))
        right = np.abs(np.hstack([linked[:, 1:], alone]) - by)
        dd = d[:, 1:] * d[:, :-1]
        limit, slope = self.step * dd, _SLOPE * np.hypot(*np.moveaxis(np.diff(p[..., :2], axis=1), -1, 0)) * dd
        single = np.isnan(left) & np.isnan(right)
        jump = (np.abs(by) > limit + slope / 2) & ~(left <= limit) & ~(right <= limit)
        return turn(~same | np.where(single, np.abs(by) > limit + slope, jump))

    def walk(self, at: tuple[int, int], axis: int, sign: int) -> tuple[int, int]:
        """The cell up to two cells along an axis, not over a step."""
        for _ in range(_REACH):
            to = (at[0] + sign * axis, at[1] + sign * (1 - axis))
            if min(to) < 0 or to[0] >= self.d.shape[0] or to[1] >= self.d.shape[1]:
                break
            edge = self.bends[(*(at if sign > 0 else to), axis)]
            if np.isnan(edge) or edge == _STEP:
                break
            at = to
        return at

    def _normal(self, at: tuple[int, int]) -> Array:
        """Of the plane whose inverse depth fits the cells around best: a x + b y + e z = 1."""
        if not self.cluster[at]:
            return np.full(3, np.nan)
        rows = [(i, at[1]) for i in range(self.walk(at, 1, -1)[0], self.walk(at, 1, 1)[0] + 1)]
        around = [(i, j) for i, c in rows for j in range(self.walk((i, c), 0, -1)[1], self.walk((i, c), 0, 1)[1] + 1)]
        uv = np.array([self.p[one][:2] * self.d[one] for one in around])
        spread = np.cov(uv.T, bias=True) if len(uv) >= 5 else np.zeros((2, 2))
        if not np.linalg.det(spread) > 1e-3 * spread[0, 0] * spread[1, 1]:
            return np.full(3, np.nan)
        plane = np.linalg.lstsq(np.column_stack([uv, np.ones(len(uv))]), [self.d[one] for one in around], rcond=None)[0]
        return -plane / np.linalg.norm(plane)

    def _bend(self, at: tuple[int, int], axis: int) -> float:
        """Chord of the normals on both sides of an edge, positive where concave."""
        edge = self.bends[(*at, axis)]
        if edge != 0.0:
            return edge
        a, b = self.walk(at, axis, -1), self.walk((at[0] + axis, at[1] + 1 - axis), axis, 1)
        turn = self.n[a] - self.n[b]
        if np.isnan(turn).any():
            return 0.0
        return float(np.linalg.norm(turn) * (1.0 if turn @ (self.p[a] - self.p[b]) < 0.0 else -1.0))

    def fragments(self) -> Array:
        """Cells away from concave edges, connected, grown over the others; (h, w), 0 for none."""
        h, w = self.d.shape
        least, ids = self.angle * 2.0 / 3.0, np.arange(h * w).reshape(h, w)
        edges = [
            (i * w + j, (i + axis) * w + j + 1 - axis, self.bends[i, j, axis])
            for i, j, axis in np.ndindex(h, w, 2)
            if np.isfinite(self.bends[i, j, axis])
        ]
        core = np.isfinite(self.n[..., 0]).ravel()
        for a, b, bend in edges:
            if bend > least:
                core[[a, b]] = False
        links = np.array([(a, b) for a, b, bend in edges if bend <= least and core[a] and core[b]]).reshape(-1, 2)
        graph = coo_array((np.ones(len(links)), links.T), shape=(ids.size, ids.size))
        part = np.where(core, connected_components(graph, directed=False)[1] + 1, 0)
        limit = least
        while limit <= 2.0 * _STEP:
            before = None
            while before is None or (before != part).any():
                before = part.copy()
                for a, b, bend in edges:
                    if bend <= limit and (before[a] == 0) != (before[b] == 0):
                        part[b if before[a] else a] = before[a] + before[b]
            limit = limit + 0.14 if limit < _FULL else 2.0 * limit
        left = (self.cluster.ravel() > 0) & (part == 0)
        part[left] = part.max() + 1 + np.arange(np.count_nonzero(left))
        return part.reshape(h, w)

    def borders(self, part: Array) -> dict[tuple[int, int], tuple[float, int]]:
        """Of each pair of fragments: sum of bends, number of edges."""
        found: dict[tuple[int, int], tuple[float, int]] = {}
        for i, j, axis in np.argwhere(np.isfinite(self.bends)):
            one, other = part[i, j], part[i + axis, j + 1 - axis]
            if one != other:
                pair = (min(one, other), max(one, other))
                total, length = found.get(pair, (0.0, 0))
                found[pair] = (total + min(max(self.bends[i, j, axis], 0.0), _FULL), length + 1)
        return found

    def joined(self, part: Array) -> Array:
        """Fragments joined while a border bends less than the angle, or a fragment is smaller than a fingertip."""
        while True:
            area = {k: ((self.pitch * self.p[part == k][:, 2]) ** 2).sum() for k in np.unique(part[part > 0])}
            rated = {
                pair: total / length - (10.0 if min(area[pair[0]], area[pair[1]]) < self.least_m2 else 0.0)
                for pair, (total, length) in self.borders(part).items()
            }
            best = min(rated, key=lambda pair: rated[pair], default=None)
            if best is None or rated[best] >= self.angle:
                return part
            part = np.where(part == best[1], best[0], part)

    def pixels(self, part: Array) -> Array:
        """(H, W) parts of the pixels: of the nearest cell of the same cluster."""
        y, x = np.indices(self.labels.shape)
        best, names = np.full(self.labels.shape, np.inf), np.zeros(self.labels.shape, int)
        for di, dj in np.ndindex(3, 3):
            i, j = y // self.k + di - 1, x // self.k + dj - 1
            inside = (i >= 0) & (j >= 0) & (i < part.shape[0]) & (j < part.shape[1])
            i, j = np.where(inside, i, 0), np.where(inside, j, 0)
            apart = ((y + 0.5) / self.k - i - 0.5) ** 2 + ((x + 0.5) / self.k - j - 0.5) ** 2
            apart = apart + ((self.xyz[..., 2] - self.p[i, j, 2]) / _LIKE) ** 2
            nearer = inside & (self.labels > 0) & (self.cluster[i, j] == self.labels) & (apart < best)
            best, names = np.where(nearer, apart, best), np.where(nearer, part[i, j], names)
        return names


def split_clusters(xyz, across, h, w, k, settings, solid, labels, counts) -> None:
    """The kernel's arguments; only the number of parts is counted."""
    points = np.lib.stride_tricks.as_strided(xyz, (h, w, 3), (across * 12, 12, 4))
    one = Split(points, labels.copy(), solid, k, settings)
    parts = one.pixels(one.joined(one.fragments()))
    labels[...] = np.unique(np.append(parts, 0), return_inverse=True)[1][:-1].reshape(labels.shape)
    counts[:] = 0
    counts[0] = labels.max()
