# SPDX-License-Identifier: Apache-2.0
"""What `split_window` computes with `split.c`, in NumPy and SciPy and double precision."""

from collections.abc import Iterator
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
Pair = tuple[int, int]
_STEP, _FULL, _CONVEX, _REACH, _SLOPE, _LIKE = 2.0, 0.7, 0.17, 2, 4.0, 0.005
_NECK, _TINY, _SMOOTH = 2, 10, 2.0  # fragments
_HOLLOW, _EVEN = 0.1, 0.02  # shapes
_TURN, _SKEW = 0.25, 0.05  # on both sides of a nearer part


class Split:
    """Cells of a window and what is found of them.

    Args:
        xyz: (H, W, 3) points.
        labels: (H, W) clusters, 0 for none.
        solid: (H, W) pixels with a reliable depth.
        k: Pixels of a cell's side.
        settings: Angle [rad], step [m], smallest part [m2], least log odds, plane (4), pitch of the cells, noise [1/m].
    """

    def __init__(self, xyz: Array, labels: Array, solid: Array, k: int, settings: Array) -> None:
        self.k, self.xyz, self.labels = k, xyz.astype(np.float64), labels
        self.angle, self.step, self.least_m2, self.table, self.pitch = *settings[:3], settings[4:8], settings[8]
        self.noise = settings[9]
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
        middle = tuple((2 * (i * self.k) + n) // 2 - i * self.k for i, n in zip(at, here.shape, strict=True))
        self.p[at], self.d[at] = self.xyz[window][middle], 1.0 / z[middle]  # of no part
        if not here.any():
            return
        first = np.argmax(here.any(axis=1))
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
        """(h, w) distance from the nearest edge that may separate, in halves of a cell, diagonals 3."""
        h, w = self.d.shape
        start = np.where(np.isfinite(self.n[..., 0]), np.inf, 0.0)
        start[[0, -1]], start[:, [0, -1]] = np.minimum(start[[0, -1]], 1.0), np.minimum(start[:, [0, -1]], 1.0)
        for i, j, axis in np.argwhere(~(self.bends <= self.angle)):
            for at in ((i, j), (i + axis, j + 1 - axis)):
                if at[0] < h and at[1] < w:
                    start[at] = min(start[at], 1.0)
        while True:
            around = np.pad(start, 1, constant_values=np.inf)
            ways = [(i, j) for i in range(3) for j in range(3)]
            near = [around[i : i + h, j : j + w] + (0, 2, 3)[abs(i - 1) + abs(j - 1)] for i, j in ways]
            if ((closer := np.min(near, axis=0)) == start).all():
                return start
            start = closer

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
                if at not in parent or not self.bends[edge] <= self.angle:
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

    def joined(self, part: Array, trees: Array, least: float, counts: list[int]) -> Array:
        """Tiny fragments joined across the border that bends and steps least, then those rated as one object, then small parts."""
        lines, rated, step, accepted = self.lines(part), {}, 0, {}
        groups = {int(k): frozenset([int(k)]) for k in np.unique(part[part > 0])}
        while step < 3:
            cells = {k: np.count_nonzero(part == k) for k in groups}
            area = {k: ((self.pitch * self.p[part == k][:, 2]) ** 2).sum() for k in groups}
            ends, both, bends = self.edges(part)
            pairs = {(min(one), max(one)) for one in [*both.tolist(), *(line[:2] for line in lines)]}
            found: list[tuple[float, Pair, bool]] = []
            for a, b in sorted(pairs):
                of = ((both == (a, b)) | (both == (b, a))).all(axis=1)
                if step == 0 and of.any() and min(cells[a], cells[b]) < _TINY:
                    stepped = np.mean(bends[of] == _STEP)
                    found.append((-np.clip(bends[of], 0.0, _FULL).mean() - stepped, (a, b), True))
                if step > 0:
                    key = groups[a], groups[b]
                    if key not in rated:
                        agree = [line[2] for line in lines if {line[0], line[1]} == {a, b}]
                        smooth = of.any() and np.clip(bends[of], 0.0, _FULL).mean() < self.angle
                        row = self.features(part, a, b, ends[of], bends[of], agree)
                        rated[key] = _SMOOTH * smooth + _odds(trees, row)
                    if (rated[key] > least) if step == 1 else (of.any() and min(area[a], area[b]) < self.least_m2):
                        found.append((rated[key], (a, b), bool(of.any())))
            if not found:
                step += 1
                continue
            _, (a, b), border = max(found, key=lambda one: one[0])
            counts[1 if step != 1 else 2 if border else 3] += 1
            odds = [] if step == 0 else [rated[groups[a], groups[b]]]
            accepted[a] = min([*odds, *(accepted.pop(k, np.inf) for k in (a, b))])
            groups[a] |= groups.pop(b)
            part = np.where(part == b, a, part)
            lines = [(*(a if k == b else k for k in line[:2]), line[2]) for line in lines]
            lines = [line for line in lines if line[0] != line[1]]
        refused = {
            k: max((odds for pair, odds in rated.items() if self.borders(pair, k, groups)), default=-np.inf)
            for k in groups
        }
        self.joins = {k: (refused[k], accepted.get(k, np.inf), np.count_nonzero(part == k)) for k in groups}
        return part

    @staticmethod
    def borders(pair: tuple[frozenset[int], frozenset[int]], k: int, groups: dict[int, frozenset[int]]) -> bool:
        """Whether a rated pair is a part and another one, both as they are at last."""
        return groups[k] in pair and all(side in groups.values() for side in pair)

    def features(self, part: Array, a: int, b: int, ends: Array, bends: Array, agree: list[bool]) -> list[float]:
        """What the trees are told of two parts, as `describe` of the kernel."""
        area = {k: ((self.pitch * self.p[part == k][:, 2]) ** 2).sum() for k in (a, b)}
        small, large = (a, b) if area[a] < area[b] else (b, a)
        one, two, both = (self.shape(np.isin(part, of)) for of in ([small], [large], [a, b]))
        nearer = self.p[ends[..., 0], ends[..., 1], 2]
        own = part[ends[..., 0], ends[..., 1]] == small
        before = np.where((nearer[:, 0] < nearer[:, 1]) == own[:, 0], 1.0, -1.0)
        steps, count = bends == _STEP, max(1, len(bends))
        apart, turn = one["middle"] - two["middle"], one["normal"] - two["normal"]
        beside = np.linalg.norm(np.cross(one["middle"] - two["axis"], two["u"]))
        blunt, convex = np.clip(bends, 0.0, _FULL).sum(), (bends < -_CONVEX).sum()
        found = [blunt / count, steps.sum() / count, convex / count, bends[~steps].sum() / max(1, (~steps).sum())]
        found += [before.sum() / count, before[steps].sum() / max(1, steps.sum())]
        found += [np.mean(agree) if agree else -1.0, np.sum(agree) / np.sqrt(one["cells"])]
        side, other = np.sqrt(area[small] / one["cells"]), np.pad(part, ((0, 1), (0, 1)))
        up, heights = self.table[:3], [self.p[part == k] @ self.table[:3] + self.table[3] for k in (small, large)]
        touching = self.edges(part)[1]
        for k, shape, above in ((small, one, heights[0]), (large, two, heights[1])):
            edges = [((other == k) != (np.roll(other, 1, axis=axis) == k))[1 - axis :, axis:] for axis in (0, 1)]
            outline = sum(edge.sum() for edge in edges)
            found += [len(bends) * side / np.sqrt(area[k]), len(bends) / outline]
            found += [shape["flat"], shape["thin"], shape["side"], shape["out"] / np.sqrt(area[k])]
            found += [abs(shape["normal"] @ apart), shape["hollow"]]
            touch = (touching == k).any(axis=1).sum()
            found += [np.sqrt(shape["cells"]), above.min(), above.max(), touch / outline, shape["slim"]]
        found += [
            np.sqrt(area[small] / area[large]),
            np.linalg.norm(turn),
            two["normal"] @ apart,
            one["normal"] @ apart,
        ]
        found += [up @ apart, heights[0].max() - heights[1].max(), heights[0].min() - heights[1].min()]
        found += [two["miss"], abs(two["u"] @ up), beside]
        size = area[small] + area[large]
        found += [both["miss"], both["next"], abs(both["u"] @ up), both["thin"], size / both["spread"], one["miss"]]
        uneven = (np.clip(bends, -_FULL, _FULL) ** 2).sum() / count - (bends[~steps].sum() / count) ** 2
        found += [(bends > self.angle).sum() / count, np.sqrt(abs(uneven))]
        for key, of in (("miss", "seen"), ("thin", "cells")):
            apiece = (one[key] ** 2 * one[of] + two[key] ** 2 * two[of]) / max(1, one[of] + two[of])
            found.append(both[key] - np.sqrt(apiece))
        middle = self.p[ends[..., 0], ends[..., 1]].mean(axis=(0, 1)) if len(bends) else two["middle"]
        at, high = middle - two["middle"], middle @ up + self.table[3] if len(bends) else 0.0
        top, bottom = min(above.max() for above in heights), max(above.min() for above in heights)
        found += [top - high, high - bottom, high / max(top, 0.005)]
        far = apart @ apart + 1e-9
        valley = (both["normal"] @ at - (at @ apart) / far * (both["normal"] @ apart)) / np.sqrt(far)
        found += [one["normal"] @ at - one["normal"] @ apart, two["normal"] @ at, valley]
        out = (one["out"] * one["seen"] + two["out"] * two["seen"]) / max(1, one["seen"] + two["seen"])
        found += [both["out"] / np.sqrt(size), (both["out"] - out) / np.sqrt(size)]
        return [*found, side, self.noise * side / self.pitch**2]

    def shape(self, of: Array) -> dict[str, Any]:
        """The shape of cells; the axis that their normals meet is that of a linear complex of lines (Pottmann, Randrup 1998)."""
        seen = of & np.isfinite(self.n[..., 0])
        p, n, count = self.p[seen], self.n[seen], max(1, np.count_nonzero(seen))
        middle = p.sum(axis=0) / count
        m = np.cross(p - middle, n)
        even = n.T @ n + (_EVEN * count + 1e-9) * np.eye(3)
        values, vectors = np.linalg.eigh(m.T @ m - (n.T @ m).T @ np.linalg.solve(even, n.T @ m))
        u, length = vectors[:, 0], np.linalg.norm(n.sum(axis=0))
        bent = ((self.bends > _HOLLOW) & (self.bends < _STEP)).any(axis=-1)
        spread = np.linalg.eigvalsh(np.cov(self.p[of].T, bias=True))
        return {
            "cells": np.count_nonzero(of),
            "seen": np.count_nonzero(seen),
            "middle": self.p[of].mean(axis=0),
            "normal": n.sum(axis=0) / length if length else np.zeros(3),
            "flat": length / count,
            "thin": np.sqrt(max(0.0, spread[0])),
            "slim": np.sqrt(abs(spread[1] / (spread[2] + 1e-9))),
            "spread": 12.0 * np.sqrt(abs(spread[1] * spread[2]) + 1e-12),
            "out": ((p - middle) * n).sum() / count,
            "hollow": np.count_nonzero(bent & seen) / count,
            "u": u,
            "axis": middle + np.cross(u, -np.linalg.solve(even, n.T @ m) @ u),
            "miss": np.sqrt(max(0.0, values[0] / count)),
            "next": np.sqrt(max(0.0, values[1] / count)),
            "side": 1.0 - ((n @ u) ** 2).sum() / count,
        }

    def lines(self, part: Array) -> list[tuple[int, int, bool]]:
        """Lines of cells from a part to another one behind a nearer one, and whether the surfaces agree."""
        found = []
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
            found.append((int(part[i, j]), int(part[far]), bool(agree)))
        return found

    def on_ray(self, at: Pair, ray: Pair) -> float:
        """Depth of the plane of a cell on the ray of another."""
        return float(self.n[at] @ self.p[at] / (self.n[at] @ (self.p[ray] / self.p[ray][2])))

    def beyond(self, part: Array, at: Pair, surface: Pair, axis: int) -> Pair | None:
        """The first cell along a line behind the nearer ones that hide a surface."""
        hidden = shown = 0
        for to in self.line(at, axis):
            if not np.isfinite(self.d[to]):
                continue
            if part[to] == part[at]:
                return None
            depth = self.on_ray(surface, to)
            if self.cluster[to] and self.p[to][2] < depth and self.d[to] > 1.0 / depth + self.step / depth**2:
                hidden += 1
            elif self.cluster[to] and hidden:
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


def _odds(trees: Array, row: list[float]) -> float:
    """Sum of the leaves that a row reaches, of complete trees in the order of a heap."""
    total, inner, row = 0.0, len(trees[0]) // 3, np.float32(row)
    for tree in trees:
        at = 0
        while at < inner:
            at = 2 * at + 1 + int(row[int(tree[2 * at])] > tree[2 * at + 1])
        total += float(tree[inner + at])
    return total


def split_window(xyz: Array, window: Any, cell: int, settings: Array, trees: Array) -> tuple[Array, list[int], Array]:
    """The parts of a window; the number of clusters, of parts, those joined for each reason, and the pairs that were rated; and the joins of each part."""
    h, w = window.labels.shape
    points = xyz[window.rows : window.rows + h, window.columns : window.columns + w]
    one, counts = Split(points, window.labels.copy(), window.solid, cell, settings), [0] * 5
    parts = one.pixels(one.joined(one.fragments(), trees, settings[3], counts))
    names, labels = np.unique(np.append(parts, 0), return_inverse=True)
    labels = labels[:-1].reshape(h, w).astype(np.int32)
    counts[0] = int(labels.max())
    counts = [len(np.unique(window.labels[window.solid])), *counts]
    return labels, counts, np.array([one.joins.get(k, (np.nan,) * 3) for k in names.tolist()])
