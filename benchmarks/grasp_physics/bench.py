# SPDX-License-Identifier: Apache-2.0
"""How often does the first grasp hold the object? See README.md."""

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import yaml

from benchmarks.common import add_data, show_tables, write_csv
from benchmarks.grasp_physics.camera import VIEWS, see
from benchmarks.grasp_physics.figure import Case, draw
from benchmarks.grasp_physics.objects import Item, read_items
from benchmarks.grasp_physics.simulation import HELD, OPENING_M, Verdict, held
from benchmarks.grasp_physics.surface import best_grasp
from foretouch.camera.device import ensure_libusb
from foretouch.grasp.config import GraspMethod
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import Float64
from foretouch.types.scene import Object
from foretouch_lab.experiments.shared.tables import grouped, select, unique

HERE: Final = Path(__file__).parent
RULE: Final = "simple rule"
BEST: Final = "best on the true surface"
OURS: Final = get_args(GraspMethod)
METHODS: Final = (*OURS, RULE, BEST)
DEFAULT: Final = PipelineConfig().grasp.method
REFERENCE: Final = "original"  # whose time the others are compared with
NO_OBJECT: Final = "no object found"
NO_GRASP: Final = "no grasp"
TIPS_MM: Final = (8.0, 12.5)  # radius; the first is that of the table
FRICTIONS: Final = (0.8, 0.5, 1.2)
_DIRECTIONS = np.radians(np.arange(0.0, 180.0, 5.0))
_TAIL = 0.01  # of the points, left out at either end
_DRAWS = 10_000

Row = dict[str, Any]


def rows_of(
    item: Item,
    poses: int = 8,
    methods: Sequence[str] = METHODS,
    conditions: Sequence[tuple[float, float]] = ((TIPS_MM[0], FRICTIONS[0]),),
    settings: Mapping[str, Any] | None = None,
) -> Iterator[Row]:
    """Iterate over what became of the grasps on one object: "held", the kind of failure, or why there was none, and the time of the plan.

    Args:
        item: The object.
        poses: How many of it.
        methods: That plan.
        conditions: Radius of the tips [mm] and friction, one or more of them.
        settings: Of the pipeline, by dotted keys.
    """
    for number, view in product(range(poses), VIEWS):
        seen = see(item, number, view)
        targets = Pipeline().segment(seen.cloud).targets
        for method in methods:
            ms = math.nan
            grasp = None
            reason = NO_GRASP
            if method != BEST and not targets:
                reason = NO_OBJECT
            elif method != BEST:
                pipeline, start = pipeline_of(method, settings), time.thread_time()
                contacts = propose(method, pipeline, targets[0])
                ms = 1e3 * (time.thread_time() - start)
                grasp = None if contacts is None else seen.camera.to_world(contacts)
            facts = {"object": item.name, "pose": number, "view": view, "method": method, "ms": ms}
            for tip, friction in conditions:
                if method == BEST:
                    grasp = best_grasp(item, seen.pose, tip * 1e-3, friction)
                verdict = Verdict(False, False, reason)
                if grasp is not None:
                    verdict = held(item, seen.pose, *grasp, tip * 1e-3, friction)
                yield facts | {"tip_mm": tip, "friction": friction} | verdict._asdict()


def pipeline_of(method: str, settings: Mapping[str, Any] | None) -> Pipeline:
    """Return a pipeline that plans by a method."""
    return Pipeline(PipelineConfig().updated({"grasp.method": method, **(settings or {})} if method in OURS else {}))


def propose(method: str, pipeline: Pipeline, target: Object) -> Float64 | None:
    """Return contacts (2, 3) in the camera frame of the first grasp; None where there is none."""
    if method == RULE:
        return simple_rule(target)
    plan = pipeline.plan(target)
    return np.stack([plan.grasps[0].g1, plan.grasps[0].g2]) if plan.grasps else None


def simple_rule(target: Object) -> Float64:
    """Return (2, 3) contacts in the camera frame: a horizontal line across the narrower side of the visible footprint.

    It passes through the middle of the footprint, at half of the height that is seen, 10 mm or more over the table.
    """
    up = target.plane.normal
    xyz = target.cloud.xyz[np.isfinite(target.cloud.xyz).all(axis=1)].astype(np.float64)
    height = xyz @ up + target.plane.offset
    east = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    east /= np.linalg.norm(east)
    axes = np.stack([east, np.cross(up, east)])
    flat = xyz @ axes.T
    turned = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])
    low, high = np.quantile(flat @ turned, [_TAIL, 1.0 - _TAIL], axis=0)
    k = int(np.argmin(high - low))
    across = turned[:, k]
    along = np.array([-across[1], across[0]])
    middle = along * np.quantile(flat @ along, [_TAIL, 1.0 - _TAIL]).mean()
    level = max(0.5 * float(np.quantile(height, 1.0 - 2.0 * _TAIL)), 0.010) - target.plane.offset
    return np.stack([(middle + end * across) @ axes + level * up for end in (low[k], high[k])])


# --- tables: intervals are over objects ------------------------------------------------------------------------------


def mean(rows: Sequence[Row], what: str) -> float:
    """Return the share of grasps that are held, or held and strict."""
    return float(np.mean([row[what] for row in rows]))


def share(rows: Sequence[Row], what: str) -> str:
    """Return the mean over objects with its interval of 95 %, by drawing as many objects again, with replacement."""
    means = np.array([mean(own, what) for _, own in grouped(rows, "object")])
    again = means[np.random.default_rng(0).integers(len(means), size=(_DRAWS, len(means)))].mean(axis=1)
    low, high = np.quantile(again, [0.025, 0.975])
    return f"{means.mean():.2f} [{low:.2f}, {high:.2f}]"


def by_method(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return lines of what is held and strict by view, of the best on the true surface, and time beside that of the reference."""
    lines, reference = [], [row["ms"] for row in select(rows, method=REFERENCE)]
    for method, own in grouped(rows, "method"):
        line = {"first grasp": f"{method} (default)" if method == DEFAULT else method}
        for view, mine in grouped(own, "view"):
            best = select(rows, method=BEST, view=view)
            line |= {f"{view}: {what}": share(mine, what) for what in ("held", "strict")}
            if any(row["held"] for row in best):
                line[f"{view}: of the best"] = f"{mean(mine, 'held') / mean(best, 'held'):.2f}"
        times = [row["ms"] for row in own]
        if reference:
            ratios = (np.nanquantile(times, q) / np.nanquantile(reference, q) for q in (0.5, 0.95))
            line["time, median (p95)"] = "" if np.isnan(times).all() else "{:.2f} ({:.2f})".format(*ratios)
        lines.append(line)
    return lines


def by_method_and(rows: Sequence[Row], column: str, cell: Callable[[list[Row]], str]) -> list[dict[str, str]]:
    """Return a line for each value of a column, and in it a cell of the rows of each method."""
    methods = unique(rows, "method")
    return [
        {column: str(value)} | {method: cell(select(own, method=method)) for method in methods}
        for value, own in grouped(rows, column)
    ]


def tables(rows: Sequence[Row]) -> dict[str, list[dict[str, str]]]:
    """Return all tables by what they hold; but for the last one, under the first conditions."""
    (tip, friction), first = grouped(rows, "tip_mm", "friction")[0]
    conditions = [{**row, "tip_mm, friction": f"{row['tip_mm']}, {row['friction']}"} for row in rows]
    often = Counter(row["reason"] for row in first)
    ended = sorted(first, key=lambda row: (not row["reason"].startswith("held"), -often[row["reason"]]))
    both = lambda own: f"{mean(own, 'held'):.2f} / {mean(own, 'strict'):.2f}"  # noqa: E731
    return {
        f"Tips of {tip:g} mm radius, friction {friction:g}": by_method(first),
        "What became of the grasps": by_method_and(ended, "reason", lambda own: str(len(own))),
        "Held, by object": by_method_and(first, "object", lambda own: f"{mean(own, 'held'):.2f}"),
        "Held / strict under all conditions": by_method_and(conditions, "tip_mm, friction", both),
    }


def pictured(rows: Sequence[Row], items: Sequence[Item], settings: Mapping[str, Any] | None = None) -> Iterator[Case]:
    """Iterate over a grasp that holds and one of each kind of failure, planned again; of the default method and seen obliquely where there is one."""
    (tip, _), first = grouped(rows, "tip_mm", "friction")[0]
    planned = [row for row in first if row["method"] != BEST]
    reasons = {row["reason"] for row in planned} - {NO_GRASP, NO_OBJECT}
    for reason in sorted(reasons, key=lambda text: (text != HELD, HELD not in text, text)):
        order = lambda row: (row["method"] != DEFAULT, row["method"] == RULE, row["view"] != VIEWS[0])  # noqa: E731
        name, number, view, method, *_ = min(select(planned, reason=reason), key=order).values()
        (item,) = (item for item in items if item.name == name)
        seen = see(item, number, view)
        target = Pipeline().segment(seen.cloud).targets[0]
        contacts, points = propose(method, pipeline_of(method, settings), target), target.cloud.xyz.astype(np.float64)
        title = f"{reason.replace(f'{HELD}, ', f'{HELD}, but ')}\n{name},\n{method}, {view}"
        yield Case(title, item.at(seen.pose), *map(seen.camera.to_world, (points, contacts)), 1e-3 * tip)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--objects", type=Path, help="folder of objects (default: ycb in the folder of recordings)")
    parser.add_argument("--only", nargs="+", metavar="OBJECT", help="these objects alone")
    parser.add_argument("--poses", type=int, default=8, help="of each object")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, metavar="METHOD")
    parser.add_argument("--all", action="store_true", help="also the other tips and frictions of the table")
    parser.add_argument("--set", nargs="+", default=[], metavar="SETTING=VALUE", help="of the pipeline")
    parser.add_argument("--rows", type=Path, help="write one row for each grasp to this CSV")
    parser.add_argument("--renew", action="store_true", help="write the committed tables and the picture")
    options = parser.parse_args()
    ensure_libusb()
    conditions = [(TIPS_MM[0], friction) for friction in FRICTIONS] + [(tip, FRICTIONS[0]) for tip in TIPS_MM[1:]]
    chosen = options.poses, options.methods, conditions if options.all else conditions[:1]
    settings = {name: yaml.safe_load(value) for name, _, value in (text.partition("=") for text in options.set)}
    items = read_items(options.objects or Path(options.data or "") / "ycb")
    items = [item for item in items if not options.only or item.name in options.only]
    if not items:
        parser.error(f"--only: {', '.join(options.only)}: there is no such object")
    rows = [row for item in items for row in rows_of(item, *chosen, settings)]
    if options.rows:
        write_csv(options.rows, rows)
    head = f"{len(items)} objects, {options.poses} poses each, opening {1e3 * OPENING_M:g} mm."
    show_tables(tables(rows), head, HERE / "README.md" if options.renew else None)
    if options.renew:
        draw(list(pictured(rows, items, settings)), HERE / "grasps.png")


if __name__ == "__main__":
    main()
