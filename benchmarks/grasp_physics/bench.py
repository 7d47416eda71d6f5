# SPDX-License-Identifier: Apache-2.0
"""How often does the first grasp hold the object? See README.md."""

import argparse
import multiprocessing
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.common import add_data, print_rows, write_csv
from benchmarks.grasp_physics import analytic
from benchmarks.grasp_physics.camera import VIEWS, see
from benchmarks.grasp_physics.methods import DEFAULT, METHODS, Planner, Proposal, find
from benchmarks.grasp_physics.objects import Item, Placed, read_items
from benchmarks.grasp_physics.simulation import OPENING_M, Outcome, grip, verdict
from foretouch.libusb import ensure_libusb
from foretouch.types import Float64

HERE: Final = Path(__file__).parent
TIPS_MM: Final = (8.0, 12.5)  # radius
FRICTIONS: Final = (0.8, 0.5, 1.2)


@dataclass(frozen=True)
class Conditions:
    """Of one closing."""

    tip_mm: float
    friction: float
    opening_mm: float


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
    reason: str
    analytic: bool  # whether the friction cones say that it holds
    opening_mm: float
    clearance_mm: float
    status: str
    ms: float


@dataclass(frozen=True)
class Task:
    """What one process does: all images of one object."""

    item: Item
    poses: int
    views: tuple[str, ...]
    methods: tuple[str, ...]
    conditions: tuple[Conditions, ...]
    cache: Path | None


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_options(parser)
    options = parser.parse_args()
    ensure_libusb()
    start = time.perf_counter()
    rows = measure(tasks(options), options.workers)
    if options.rows:
        write_csv(options.rows, [asdict(row) for row in rows])
    for one in conditions(options):
        print(f"\ntips of {one.tip_mm:g} mm, friction {one.friction:g}")
        print_rows([summary(rows, method, one) for method in options.methods])
    print_reasons(rows, options.methods)
    print(f"\n{len(rows)} closings in {time.perf_counter() - start:.0f} s")


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of all modes."""
    add_data(parser)
    parser.add_argument("--objects", type=Path, help="folder of objects (default: ycb in the folder of recordings)")
    parser.add_argument("--only", nargs="+", metavar="OBJECT", help="these objects alone")
    parser.add_argument("--poses", type=int, default=8, help="of each object")
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=VIEWS)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--tip-mm", nargs="+", type=float, default=TIPS_MM[:1], help="radius of the tips [mm]")
    parser.add_argument("--friction", nargs="+", type=float, default=FRICTIONS[:1], help="between tip and object")
    parser.add_argument("--opening-mm", type=float, default=1e3 * OPENING_M, help="how far the hand opens [mm]")
    parser.add_argument("--workers", type=int, choices=(1, 2), default=1)
    parser.add_argument("--cache", type=Path, help="folder where images are kept")
    parser.add_argument("--rows", type=Path, help="write one row for each grasp to this CSV")


def conditions(options: argparse.Namespace) -> tuple[Conditions, ...]:
    """The first tip with each friction, and the other tips with the first friction."""
    pairs = [(options.tip_mm[0], friction) for friction in options.friction]
    pairs += [(tip, options.friction[0]) for tip in options.tip_mm[1:]]
    return tuple(Conditions(tip, friction, options.opening_mm) for tip, friction in pairs)


def tasks(options: argparse.Namespace) -> list[Task]:
    """One task for each object."""
    folder = options.objects or Path(options.data or "") / "ycb"
    items = [item for item in read_items(folder) if not options.only or item.name in options.only]
    chosen = tuple(options.views), tuple(options.methods)
    return [Task(item, options.poses, *chosen, conditions(options), options.cache) for item in items]


def measure(todo: Sequence[Task], workers: int) -> list[Row]:
    """All rows, in the order of the tasks."""
    if workers == 1:
        return [row for task in todo for row in rows_of(task)]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return [row for rows in pool.map(rows_of, todo) for row in rows]


def rows_of(task: Task) -> list[Row]:
    """All rows of one object."""
    planners = {method: Planner(method) for method in task.methods}
    return [
        row for pose in range(task.poses) for view in task.views for row in rows_of_image(task, pose, view, planners)
    ]


def rows_of_image(task: Task, pose: int, view: str, planners: dict[str, Planner]) -> Iterator[Row]:
    """The rows of one image: each method, under all conditions."""
    seen = see(task.item, pose, view, task.cache)
    surface = Placed(task.item, seen.pose)
    target = find(seen, next(iter(planners.values())).pipeline)
    for method, planner in planners.items():
        proposal = planner.propose(seen, target)
        for one in task.conditions:
            row = closed(task.item, seen.pose, surface, proposal, one)
            yield Row(task.item.name, pose, view, method, one.tip_mm, one.friction, *row, proposal.status, proposal.ms)


def closed(
    item: Item, pose: Float64, surface: Placed, proposal: Proposal, one: Conditions
) -> tuple[bool, bool, str, bool, float, float]:
    """Held, strict, reason, the second opinion, opening and clearance [mm] of one proposal."""
    outcome, second = Outcome(proposal.reason), Outcome(proposal.reason)
    if proposal.contacts is not None:
        outcome = grip(item, one.tip_mm * 1e-3, one.friction).close(pose, *proposal.contacts)
        second = analytic.close(item, surface, *proposal.contacts, one.tip_mm * 1e-3, one.friction)
    found, other = (verdict(each, one.opening_mm * 1e-3) for each in (outcome, second))
    return (*found, other.held, 1e3 * outcome.opening_m, 1e3 * outcome.clearance_m)


def summary(rows: Sequence[Row], method: str, one: Conditions) -> dict[str, object]:
    """Shares of one method under some conditions, by view."""
    name = f"{method} (default)" if method == DEFAULT else method
    result: dict[str, object] = {"method": name}
    mine = [row for row in rows if (row.method, row.tip_mm, row.friction) == (method, one.tip_mm, one.friction)]
    for view in dict.fromkeys(row.view for row in mine):
        found = [row for row in mine if row.view == view]
        result[f"{view}: held"], result[f"{view}: strict"] = share(found, "held"), share(found, "strict")
    result["cones agree"] = f"{np.mean([row.held == row.analytic for row in mine]):.2f}"
    times = [row.ms for row in mine]
    result["ms"], result["p95"] = (f"{np.nanquantile(times, q):.1f}" for q in (0.5, 0.95))
    return result


def share(rows: Sequence[Row], what: str) -> str:
    """Mean over objects, with an interval of 95 % over them."""
    objects: dict[str, list[bool]] = {}
    for row in rows:
        objects.setdefault(row.object, []).append(getattr(row, what))
    mean, low, high = interval([float(np.mean(values)) for values in objects.values()])
    return f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def interval(means: Sequence[float], draws: int = 10_000) -> tuple[float, float, float]:
    """Mean, and its interval of 95 % by drawing as many objects again, with replacement."""
    values = np.asarray(means)
    again = values[np.random.default_rng(0).integers(len(values), size=(draws, len(values)))].mean(axis=1)
    return float(values.mean()), *(float(edge) for edge in np.quantile(again, [0.025, 0.975]))


def print_reasons(rows: Sequence[Row], methods: Sequence[str]) -> None:
    """How many grasps of each method ended how."""
    reasons = sorted({row.reason for row in rows})
    counted = {(row.reason, row.method): 0 for row in rows}
    for row in rows:
        counted[row.reason, row.method] += 1
    print()
    print_rows([{"reason": reason, **{m: counted.get((reason, m), 0) for m in methods}} for reason in reasons])


if __name__ == "__main__":
    main()
