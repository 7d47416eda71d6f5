# SPDX-License-Identifier: Apache-2.0
"""Which pairs of candidates make the best grasp: GeoGrasp's two rankings (Zapata-Impata et al. 2019).

Letters: a, b candidates of the first and the second side; p1, p2 the initial points; cd distance to
the centroid, pd distance to the grasp plane, k curvature, each scaled to its side's range; w distance of
the initial points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.grasp.candidates import Slab, Spots
from foretouch.types import Float64

__all__ = ["Ranking", "initial_score", "rank_pairs"]

_OFFSET = 1e-8  # added by the original against division by zero
_LEAST_MAXIMUM = 1.17549435e-38  # the least float32, at which the original's search for the maximum starts
_SLACK = 0.98  # of the limits that the second contact has to keep
_ALIGNED = 0.2  # cosine between grasp and object axis that costs nothing
_ALIGNMENT_WEIGHT = 10.0
_FIRST_WEIGHT = 1.5
_LEAST_RANK = 1.0  # of either ranking


@dataclass(frozen=True, eq=False)
class Ranking:
    """Pairs that pass every filter, best first.

    Attributes:
        first, second: (P,) int64, indices of a and b.
        score: (P,) float64, finite.
        counts: Pairs: all, then by the filter that dropped them, then those that rank.
    """

    first: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    score: Float64
    counts: dict[str, int]


@dataclass(frozen=True)
class _Scale:
    """Maps the range of one quantity over the candidates of one side to 0 ... 1."""

    low: float
    high: float

    @classmethod
    def of(cls, values: Float64) -> _Scale:
        known = values[~np.isnan(values)]
        if len(known) == 0:
            return cls(np.inf, np.inf)
        return cls(float(known.min()), max(float(known.max()), _LEAST_MAXIMUM))

    @property
    def meaningful(self) -> bool:
        """Whether the candidates differ by more than the offset; without that the offset decides."""
        return np.isfinite(self.low) and self.high - self.low > _OFFSET

    def __call__(self, values: Float64) -> Float64:
        """Scaled values; NaN, which never ranks, where the original divides by zero."""
        extent = self.high - self.low
        if not extent > 0.0:
            return np.full(values.shape, np.nan)
        return np.asarray((values + _OFFSET - self.low) / extent, np.float64)


class _Side:
    """The candidates of one side with the scales of their three quantities."""

    def __init__(self, spots: Spots, slab: Slab, centroid: Float64) -> None:
        self._slab, self._centroid = slab, centroid
        self._cd = _Scale.of(self._to_centroid(spots.xyz))
        self._pd = _Scale.of(slab.distance(spots.xyz))
        self._k = _Scale.of(spots.curvature)
        self.xyz, self.normal = spots.xyz, spots.normal
        self.cd, self.pd, self.k = self.scaled(spots)

    def scaled(self, spots: Spots) -> tuple[Float64, Float64, Float64]:
        """cd, pd and k of any spots on this side's scales."""
        cd = self._cd(self._to_centroid(spots.xyz))
        return cd, self._pd(self._slab.distance(spots.xyz)), self._k(spots.curvature)

    @property
    def scales_score(self) -> bool:
        """Whether the scales that enter the score are more than the original's offset."""
        return self._pd.meaningful and self._k.meaningful

    def _to_centroid(self, xyz: Float64) -> Float64:
        return _length(xyz - self._centroid)


def rank_pairs(sides: tuple[Spots, Spots], initials: tuple[Spots, Spots], slab: Slab, centroid: Float64) -> Ranking:
    """All pairs of candidates that pass GeoGrasp's filters, best first; of equals the first (a outer, b inner).

    Args:
        sides: Candidates of the first and the second side.
        initials: The initial points p1 and p2, one spot each.
        slab: The grasp plane.
        centroid: (3,) float64 [m], of the object.
    """
    a, b = (_Side(side, slab, centroid) for side in sides)
    p1, p2 = (initial.xyz[0] for initial in initials)
    w = slab.width_m
    # Neither contact may lie deeper in the object than its initial point, nor may they come closer.
    skip_a = (a.cd < a.scaled(initials[0])[0]) | (_length(a.xyz - p2) < w)
    skip_b = b.cd < _SLACK * b.scaled(initials[1])[0]
    skip_b |= _length(b.xyz - p1) < _SLACK * w
    apart = b.xyz[None] - a.xyz[:, None]
    distance = _length(apart)
    near = distance < _SLACK * w
    kept = ~skip_a[:, None] & ~skip_b[None] & ~near
    i, j = np.nonzero(kept)
    r1, r2 = _two_rankings(
        apart[i, j] / distance[i, j, None],
        slab.normal,
        (a.normal[i], b.normal[j]),
        (a.pd[i], b.pd[j]),
        (a.k[i], b.k[j]),
    )
    passed = (r1 >= _LEAST_RANK) & (r2 >= _LEAST_RANK)  # a NaN passes nothing
    score = _FIRST_WEIGHT * r1[passed] + r2[passed]
    order = np.argsort(-score, kind="stable")
    counts = {
        "n_pairs": int(kept.size),
        "n_pairs_inside": int(kept.size - np.count_nonzero(kept)),
        "n_pairs_unknown": int(np.count_nonzero(np.isnan(r1) | np.isnan(r2))),
        "n_pairs_low": int(np.count_nonzero((r1 < _LEAST_RANK) | (r2 < _LEAST_RANK))),
        "n_pairs_ranked": len(order),
    }
    return Ranking(i[passed][order], j[passed][order], score[order], counts)


def initial_score(
    sides: tuple[Spots, Spots], initials: tuple[Spots, Spots], slab: Slab, centroid: Float64
) -> tuple[float, str]:
    """Score of the initial points as a grasp, on the candidates' scales and without thresholds.

    The original's may be NaN, infinite or of the order of 1e30, where a side has one candidate or all its
    candidates are alike. That has no meaning and is named instead.

    Returns:
        The score and "", or NaN and the reason.
    """
    first, second = (_Side(side, slab, centroid) for side in sides)
    p1, p2 = initials
    for name, side, initial in (("first", first, p1), ("second", second, p2)):
        if not np.isfinite(initial.curvature[0]):
            return float("nan"), f"no score: the {name} initial point has fewer than 3 points around it and no normal"
        if not side.scales_score:
            return float("nan"), f"no score: the candidates of the {name} side do not differ ({len(side.xyz)} of them)"
    _, pd1, k1 = first.scaled(p1)
    _, pd2, k2 = second.scaled(p2)
    unit = (p2.xyz - p1.xyz) / slab.width_m
    r1, r2 = _two_rankings(unit, slab.normal, (p1.normal, p2.normal), (pd1, pd2), (k1, k2))
    return float(_FIRST_WEIGHT * r1[0] + r2[0]), ""


def _two_rankings(
    unit: Float64,
    axis: Float64,
    normals: tuple[Float64, Float64],
    pd: tuple[Float64, Float64],
    k: tuple[Float64, Float64],
) -> tuple[Float64, Float64]:
    """R1 (close to the plane, across the axis) and R2 (flat, facing the grasp) of P pairs; `unit` is unit(b - a)."""
    aligned = np.abs(unit @ axis) + _OFFSET - _ALIGNED
    c_a, c_b = (np.abs(np.einsum("ij,ij->i", unit, normal)) + _OFFSET for normal in normals)
    r1 = 2.0 - pd[0] - pd[1] - _ALIGNMENT_WEIGHT * aligned
    r2 = 2.0 - k[0] - k[1] + c_a + c_b - np.abs(c_a - c_b)
    return r1, r2


def _length(vectors: Float64) -> Float64:
    """(...,) float64, of vectors (..., 3)."""
    return np.asarray(np.sqrt(np.einsum("...i,...i", vectors, vectors)), np.float64)
