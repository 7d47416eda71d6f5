# SPDX-License-Identifier: Apache-2.0
"""What `split_clusters` of `split.c` computes, in NumPy and SciPy and double precision."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

Array = np.ndarray[Any, Any]
Pair = tuple[int, int]
_STEP, _FULL, _REACH, _SLOPE, _LIKE = 2.0, 0.7, 2, 4.0, 0.005
_EDGE, _NECK = 0.75, 2  # fragments
_HOLLOW, _TOUCH = 0.1, 0.03  # vessels
_EVEN, _ECCENTRIC, _SIDE, _FLAT, _SURE, _UPRIGHT, _CLOSED, _LID = (
    0.02,
    0.006,
    0.3,
    0.9,
    2.0,
    0.7,
    0.2,
    0.1,
)  # common axis
_TURN, _SKEW, _LINES = 0.25, 0.05, 4  # on both sides of a nearer part


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
        self.angle, self.step, self.least_m2, self.table, self.pitch = *settings[:3], settings[3:7], settings[7]
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

    def depths(self) -> Array:
        """(h, w) distance from the nearest edge that may separate, in halves of a cell, diagonals 3, as a shortest path."""
        h, w = self.d.shape
        start = np.where(np.isfinite(self.n[..., 0]), np.inf, 0.0)
        start[[0, -1]], start[:, [0, -1]] = np.minimum(start[[0, -1]], 1.0), np.minimum(start[:, [0, -1]], 1.0)
        for i, j, axis in np.argwhere(~(self.bends <= _EDGE * self.angle)):
            for at in ((i, j), (i + axis, j + 1 - axis)):
                if at[0] < h and at[1] < w:
                    start[at] = min(start[at], 1.0)
        ids, source = np.arange(h * w).reshape(h, w), h * w
        links = [
            (ids[:, 1:], ids[:, :-1], 2),
            (ids[1:], ids[:-1], 2),
            (ids[1:, 1:], ids[:-1, :-1], 3),
            (ids[1:, :-1], ids[:-1, 1:], 3),
        ]
        first, second, length = (
            np.concatenate([np.broadcast_to(one[k], one[0].shape).ravel() for one in links]) for k in range(3)
        )
        begun = np.flatnonzero(np.isfinite(start))
        ends = (np.append(first, begun), np.append(second, np.full(len(begun), source)))
        graph = coo_array((np.append(length, start.ravel()[begun] + 1.0), ends), shape=(source + 1, source + 1))
        return np.rint(dijkstra(graph, directed=False, indices=source)[:-1] - 1.0).reshape(h, w)

    def fragments(self) -> Array:
        """Watersheds of that distance: a neck is a border unless it is as wide as one of both sides; (h, w), 0 for none."""
        depths, parent = self.depths(), {}

        def root(at: Pair) -> Pair:
            return at if parent[at] == at else root(parent[at])

        cells = [(i, j) for i, j in np.argwhere(self.cluster > 0).tolist()]
        for i, j in sorted(cells, key=lambda at: -depths[at]):
            own = None
            for at, edge in (
                ((i, j - 1), (i, j - 1, 0)),
                ((i, j + 1), (i, j, 0)),
                ((i - 1, j), (i - 1, j, 1)),
                ((i + 1, j), (i, j, 1)),
            ):
                if at not in parent or not self.bends[edge] <= _EDGE * self.angle:
                    continue
                one = root(at)
                deeper = own is None or depths[one] > depths[own]
                if own is not None and min(depths[one], depths[own]) < depths[i, j] + _NECK:
                    parent[own if deeper else one] = one if deeper else own
                own = one if deeper else own
            parent[i, j] = own or (i, j)
        part, names = np.zeros(self.d.shape, int), {}
        for at in cells:
            if parent[at] == at:
                names[at] = len(names) + 1
        for at in cells:
            part[at] = names[root(at)]
        return part

    def edges(self, part: Array) -> tuple[Array, Array, Array]:
        """Edges between parts: their cells (E, 2, 2), parts (E, 2) and bends (E,)."""
        at = np.argwhere(np.isfinite(self.bends))
        ends = np.stack([at[:, :2], at[:, :2] + np.stack([at[:, 2], 1 - at[:, 2]], axis=1)], axis=1)
        both = part[ends[..., 0], ends[..., 1]]
        apart = both[:, 0] != both[:, 1]
        return ends[apart], both[apart], self.bends[tuple(at[apart].T)]

    def borders(self, part: Array) -> dict[Pair, tuple[float, int, int, int]]:
        """Of each pair of parts: mean bend, edges, those at a step, and those where the first is behind less the others."""
        ends, both, bends = self.edges(part)
        z = self.p[ends[..., 0], ends[..., 1], 2]
        found: dict[Pair, list[tuple[float, bool, int]]] = {}
        for (one, other), bend, (near, far) in zip(both.tolist(), bends.tolist(), z, strict=True):
            behind = 1 if (near < far) == (one < other) else -1
            found.setdefault((min(one, other), max(one, other)), []).append(
                (min(max(bend, 0.0), _FULL), bend == _STEP, behind)
            )
        sums = {pair: np.sum(rows, axis=0) for pair, rows in found.items()}
        return {pair: (s[0] / len(found[pair]), len(found[pair]), int(s[1]), int(s[2])) for pair, s in sums.items()}

    def joined(self, part: Array, counts: list[int]) -> Array:
        """Parts joined as long as a rule tells; counts what the rules for small, hollow and concentric ones join."""
        heights, solid = self.p @ self.table[:3] + self.table[3], set()
        bent = (self.bends > _HOLLOW) & (self.bends < _STEP)
        while True:
            names = np.unique(part[part > 0]).tolist()
            area = {k: ((self.pitch * self.p[part == k][:, 2]) ** 2).sum() for k in names}
            tops = {k: heights[part == k].max() for k in names}
            hollow = {k: k not in solid and bent.any(axis=-1)[part == k].mean() > 0.5 for k in names}
            borders = self.borders(part)
            rated: dict[Pair, tuple[float, int | None]] = {}
            for (a, b), (bend, length, steps, _) in borders.items():
                if min(area[a], area[b]) < self.least_m2:
                    rated[a, b] = bend - 10.0, None if bend < self.angle else 1
                elif hollow[a] and hollow[b] and 2 * steps < length:
                    rated[a, b] = bend - 5.0, None if bend < self.angle else 2
                elif bend < self.angle:
                    rated[a, b] = bend, None
            chosen = min(rated, key=lambda pair: rated[pair][0], default=None)
            rule = rated[chosen][1] if chosen else None
            if chosen is None:
                rims = [
                    (length, (a, b))
                    for (a, b), (_, length, steps, behind) in borders.items()
                    if hollow[a] != hollow[b]
                    and (behind if hollow[b] else -behind) >= 0
                    and 2 * steps >= length
                    and abs(tops[a] - tops[b]) < _TOUCH
                ]
                if rims:
                    chosen, rule = max(rims, key=lambda one: one[0])[1], 2
                    solid.add(chosen[0])
            if chosen is None:
                chosen, rule = next((pair for pair in borders if self.concentric(part, pair, tops)), None), 4
            if chosen is None:
                return part
            if rule:
                counts[rule] += 1
            if chosen[1] in solid:
                solid.add(chosen[0])
            part = np.where(part == chosen[1], chosen[0], part)

    def concentric(self, part: Array, pair: Pair, tops: dict[int, float]) -> bool:
        """Whether the normals of both parts meet the axis of the larger one: a linear complex of lines (Pottmann, Randrup 1998)."""
        sizes = [np.count_nonzero(part == k) for k in pair]
        large, small = pair[::-1] if sizes[0] < sizes[1] else pair
        seen = {k: (part == k) & np.isfinite(self.n[..., 0]) for k in pair}
        middle, n = self.p[seen[large]].mean(axis=0), self.n[seen[large]]
        m = np.cross(self.p[seen[large]] - middle, n)
        even = n.T @ n + (_EVEN * len(n) + 1e-9) * np.eye(3)
        values, vectors = np.linalg.eigh(m.T @ m - (n.T @ m).T @ np.linalg.solve(even, n.T @ m))
        u = vectors[:, 0]
        axis = middle + np.cross(u, -np.linalg.solve(even, n.T @ m) @ u)
        turned, closed, lid = [], [], []
        for k in (large, small):
            r, n = self.p[seen[k]] - axis, self.n[seen[k]]
            r, across = r - np.outer(r @ u, u), n - np.outer(n @ u, u)
            side, off = (across**2).sum(), ((np.cross(r, across) @ u) ** 2).sum()
            flat = (across.sum(axis=0) ** 2).sum() / (len(n) * side)
            turned.append(
                side > _SIDE * len(n) and off < _ECCENTRIC**2 * side and flat < _FLAT and (across * r).sum() > 0.0
            )
            closed.append(turned[-1] and flat < _CLOSED)
            lid.append(side < _LID * len(n) and np.linalg.norm(r.mean(axis=0)) < _ECCENTRIC)
        if abs(u @ self.table[:3]) > _UPRIGHT and tops[small] < tops[large]:
            return False
        sure = values[1] > _SURE * _ECCENTRIC**2 * np.count_nonzero(seen[large])
        return bool((turned[0] and turned[1] and sure) or (closed[0] and lid[1]))

    def hidden(self, part: Array, counts: list[int]) -> Array:
        """Parts joined on both sides of a nearer one where their surfaces agree along most lines of cells."""
        votes: dict[Pair, list[int]] = {}
        for i, j, axis in np.ndindex(*self.d.shape, 2):
            to = (i + axis, j + 1 - axis)
            if not part[i, j] or to[0] >= part.shape[0] or to[1] >= part.shape[1] or part[to] == part[i, j]:
                continue
            a = self.walk((i, j), axis, -1)
            far = self.beyond(part, (i, j), a, axis) if part[a] == part[i, j] and np.isfinite(self.n[a][0]) else None
            if far is None:
                continue
            b = self.walk(far, axis, 1)
            limit = self.step + _SKEW * np.linalg.norm(self.p[a] - self.p[b])
            agree = np.linalg.norm(self.n[a] - self.n[b]) < _TURN and all(
                abs(self.p[q][2] - self.on_ray(p, q)) < limit for p, q in ((a, b), (b, a))
            )
            pair = tuple(sorted((int(part[i, j]), int(part[far]))))
            votes.setdefault(pair, []).append(int(agree))
        while True:
            chosen = next((pair for pair, one in votes.items() if sum(one) >= _LINES and 2 * sum(one) > len(one)), None)
            if chosen is None:
                return part
            counts[3] += 1
            part = np.where(part == chosen[1], chosen[0], part)
            merged: dict[Pair, list[int]] = {}
            for pair, one in votes.items():
                a, b = sorted(chosen[0] if k == chosen[1] else k for k in pair)
                if a != b:
                    merged[a, b] = merged.get((a, b), []) + one
            votes = merged

    def on_ray(self, at: Pair, ray: Pair) -> float:
        """Depth of the plane of a cell on the ray of another."""
        return float(self.n[at] @ self.p[at] / (self.n[at] @ (self.p[ray] / self.p[ray][2])))

    def beyond(self, part: Array, at: Pair, surface: Pair, axis: int) -> Pair | None:
        """The first cell along a line behind the nearer ones that hide a surface."""
        hidden = shown = 0
        for to in self.line(at, axis):
            if not self.cluster[to]:
                continue
            if part[to] == part[at]:
                return None
            depth = self.on_ray(surface, to)
            if self.p[to][2] < depth and 1.0 / self.p[to][2] > 1.0 / depth + self.step / depth**2:
                hidden += 1
            elif hidden:
                return to
            else:
                shown += 1
                if shown > 2:
                    return None
        return None

    def line(self, at: Pair, axis: int) -> Iterator[Pair]:
        """Cells to the right of a cell, or below."""
        while True:
            at = (at[0] + axis, at[1] + 1 - axis)
            if at[0] >= self.d.shape[0] or at[1] >= self.d.shape[1]:
                return
            yield at

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
    """The kernel's arguments."""
    points = np.lib.stride_tricks.as_strided(xyz, (h, w, 3), (across * 12, 12, 4))
    one, found = Split(points, labels.copy(), solid, k, settings), [0] * 5
    parts = one.pixels(one.hidden(one.joined(one.fragments(), found), found))
    labels[...] = np.unique(np.append(parts, 0), return_inverse=True)[1][:-1].reshape(labels.shape)
    found[0] = labels.max()
    counts[:] = found
