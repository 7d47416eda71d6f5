# SPDX-License-Identifier: Apache-2.0
"""The answer of the grasp planner, and the log that it is made from."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from foretouch.types import Float64, Grasp

__all__ = ["GraspPlan", "PlanLog", "PlanStatus"]

PlanStatus = Literal["ok", "initial_points", "no_grasp"]


@dataclass(frozen=True, eq=False)
class GraspPlan:
    """What GeoGrasp found on one object, and how.

    Attributes:
        status: "ok": ranked candidates. "initial_points": no candidate ranks, the one grasp returned is that
            of the initial points. "no_grasp": there is none.
        reason: Why, in words.
        grasps: Best first.
        initial_points: (2, 3) float64 [m], p1 and p2 of the slab; None where it was not reached.
        axis: (3,) float64, the object's axis; None where it was not reached.
        centroid: (3,) float64 [m], of the object; None where it was not reached.
        axis_ratio: Middle over major eigenvalue; near 1, as on a ball, the axis is arbitrary. None where not reached.
        slide_m: How far the slab was moved along the axis [m].
        counts: Points, candidates and pairs after each stage, by name.
        ms: Wall time of each stage and their `total` [ms].
    """

    status: PlanStatus
    reason: str
    grasps: tuple[Grasp, ...]
    initial_points: Float64 | None
    axis: Float64 | None
    centroid: Float64 | None
    axis_ratio: float | None
    slide_m: float
    counts: dict[str, int]
    ms: dict[str, float]


@dataclass(eq=False)
class PlanLog:
    """What is known so far; becomes a plan wherever the road ends. Fields as of `GraspPlan`."""

    initial_points: Float64 | None = None
    axis: Float64 | None = None
    centroid: Float64 | None = None
    axis_ratio: float | None = None
    slide_m: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what runs inside, also when it fails."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.ms[name] = (time.perf_counter() - start) * 1e3

    def plan(self, status: PlanStatus, reason: str, grasps: tuple[Grasp, ...] = ()) -> GraspPlan:
        """The plan that ends here."""
        return GraspPlan(
            status=status,
            reason=reason,
            grasps=grasps,
            initial_points=self.initial_points,
            axis=self.axis,
            centroid=self.centroid,
            axis_ratio=self.axis_ratio,
            slide_m=self.slide_m,
            counts=self.counts,
            ms={**self.ms, "total": sum(self.ms.values())},
        )
