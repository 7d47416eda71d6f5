# SPDX-License-Identifier: Apache-2.0
"""Images, grasps and closings of all objects, poses, views, methods and conditions, one row each."""

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from benchmarks.grasp_physics import analytic
from benchmarks.grasp_physics.camera import VIEWS, see
from benchmarks.grasp_physics.methods import METHODS, NO_GRASP, Planner, Proposal, find
from benchmarks.grasp_physics.objects import Item, Placed
from benchmarks.grasp_physics.simulation import OPENING_M, Outcome, Verdict, grip, verdict
from benchmarks.grasp_physics.surface import ANY, FIRST, best_grasps
from foretouch.pipeline import Pipeline
from foretouch.types import Float64

TIPS_MM: Final = (8.0, 12.5)  # radius; the first is that of the table
FRICTIONS: Final = (0.8, 0.5, 1.2)
ALL_METHODS: Final = (*METHODS, FIRST, ANY)


@dataclass(frozen=True)
class Conditions:
    """Of one closing."""

    tip_mm: float = TIPS_MM[0]  # radius
    friction: float = FRICTIONS[0]
    opening_mm: float = 1e3 * OPENING_M

    def close(self, item: Item, pose: Float64, surface: Placed, proposal: Proposal) -> "Closing":
        """The simulated closing of a proposal, and the second opinion."""
        if proposal.contacts is None:
            return Closing(Verdict(False, False, proposal.reason))
        tip_m, opening_m = self.tip_mm * 1e-3, self.opening_mm * 1e-3
        outcome = grip(item, tip_m, self.friction).close(pose, *proposal.contacts)
        second = analytic.close(item, surface, *proposal.contacts, tip_radius_m=tip_m, friction=self.friction)
        return Closing(verdict(outcome, opening_m), verdict(second, opening_m).held, outcome)


@dataclass(frozen=True)
class Closing:
    """Both opinions on one grasp."""

    verdict: Verdict
    analytic: bool = False
    outcome: Outcome = field(default_factory=lambda: Outcome(""))


@dataclass(frozen=True)
class Row:
    """What became of one grasp."""

    object: str
    pose: int
    view: str
    method: str
    tip_mm: float
    friction: float
    held: bool
    strict: bool
    reason: str  # "held", the kind of failure, or why there was no grasp
    analytic: bool  # whether it holds by the friction cones
    opening_mm: float  # distance of the contacts; NaN where the tips never closed
    clearance_mm: float  # of the lower tip from the table
    status: str  # of the plan
    ms: float  # time of the plan


@dataclass(frozen=True)
class Task:
    """What one process does: all images of one object."""

    item: Item
    poses: int = 8
    views: tuple[str, ...] = VIEWS
    methods: tuple[str, ...] = ALL_METHODS
    conditions: tuple[Conditions, ...] = (Conditions(),)
    cache: Path | None = None  # folder where images are kept
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the pipeline, by dotted keys
    repeats: int = 1  # of each plan; the least time counts


def measure(tasks: Sequence[Task], workers: int = 1) -> list[Row]:
    """All rows, in the order of the tasks."""
    if workers == 1:
        return [row for task in tasks for row in rows_of(task)]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return [row for rows in pool.map(rows_of, tasks) for row in rows]


def rows_of(task: Task) -> list[Row]:
    """All rows of one object."""
    planners = {name: Planner(name, task.settings) for name in task.methods if name in METHODS}
    rows: list[Row] = []
    for pose in range(task.poses):
        for view in task.views:
            rows += _planned(task, pose, view, planners)
        best = list(_best(task, pose)) if {FIRST, ANY} & set(task.methods) else []
        rows += [replace(row, view=view) for view in task.views for row in best]  # they do not depend on the camera
    return rows


def _planned(task: Task, pose: int, view: str, planners: Mapping[str, Planner]) -> Iterator[Row]:
    """The rows of the methods for one image."""
    if not planners:
        return
    seen = see(task.item, pose, view, task.cache)
    surface = Placed(task.item, seen.pose)
    target = find(seen, Pipeline())
    for method, planner in planners.items():
        proposal = planner.propose(seen, target, task.repeats)
        for one in task.conditions:
            yield _row(task, pose, view, method, one, one.close(task.item, seen.pose, surface, proposal), proposal)


def _best(task: Task, number: int) -> Iterator[Row]:
    """The rows of the best grasps on the true surface, for one pose."""
    pose = task.item.pose(number)
    surface = Placed(task.item, pose)
    for one in task.conditions:
        found = best_grasps(task.item, surface, one.tip_mm * 1e-3, one.friction, one.opening_mm * 1e-3)
        proposals = [Proposal(contacts, "", "ok") for contacts in found] or [Proposal(None, NO_GRASP)]
        count = len(proposals) if ANY in task.methods else 1
        closings = [one.close(task.item, pose, surface, proposal) for proposal in proposals[:count]]
        best = max(closings, key=lambda closing: closing.verdict[:2])
        for method, closing in ((FIRST, closings[0]), (ANY, best)):
            if method in task.methods:
                yield _row(task, number, "", method, one, closing, proposals[0])


def _row(task: Task, pose: int, view: str, method: str, one: Conditions, closing: Closing, proposal: Proposal) -> Row:
    opening, clearance = (1e3 * value for value in (closing.outcome.opening_m, closing.outcome.clearance_m))
    found = (*closing.verdict, closing.analytic, opening, clearance, proposal.status, proposal.ms)
    return Row(task.item.name, pose, view, method, one.tip_mm, one.friction, *found)
