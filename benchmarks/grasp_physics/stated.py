# SPDX-License-Identifier: Apache-2.0
"""Is what a grasp states true? Its width, the bound of it, and whether it can carry a given mass. See STATED.md."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.common import add_data, show_tables, write_csv
from benchmarks.grasp_physics.camera import VIEWS, see
from benchmarks.grasp_physics.objects import Item, read_items
from benchmarks.grasp_physics.simulation import held
from benchmarks.grasp_physics.surface import meet
from foretouch.camera.device import ensure_libusb
from foretouch.grasp.carry import CANNOT_CARRY
from foretouch.grasp.completed import MAY_NOT_FIT
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch_lab.experiments.shared.tables import grouped

HERE: Final = Path(__file__).parent
LIGHT_KG: Final = 0.03  # with which a grasp that fails by the weight alone holds
COUNT: Final = 3  # grasps an image; widths are those of the first

Row = dict[str, Any]


def rows_of(item: Item, poses: int) -> Iterator[Row]:
    """Iterate over the grasps on all images of an object: what they state, and what is true.

    Args:
        item: The object.
        poses: How many of it.
    """
    pipeline = Pipeline(PipelineConfig().updated({"grasp.count": COUNT, "object.mass_kg": item.mass_kg}))
    light = replace(item, mass_kg=LIGHT_KG)
    for number, view in product(range(poses), VIEWS):
        seen = see(item, number, view)
        targets = pipeline.segment(seen.cloud).targets
        for rank, grasp in enumerate(pipeline.plan(targets[0]).grasps if targets else ()):
            ends = seen.camera.to_world(np.stack([grasp.g1, grasp.g2]))
            points = meet(item.at(seen.pose), ends[:1], ends[1:], outside_m=1.0)[0][0]
            holds = held(item, seen.pose, *ends).held
            yield {
                "object": item.name,
                "pose": number,
                "view": view,
                "rank": rank,
                "planned_mm": 1e3 * grasp.width_m,
                "at_most_mm": 1e3 * grasp.way.width_at_most_m if grasp.way else np.nan,
                "true_mm": 1e3 * float(np.linalg.norm(points[1] - points[0])),
                "may_not_fit": MAY_NOT_FIT in grasp.flags,
                "cannot_carry": CANNOT_CARRY in grasp.flags,
                "held": holds,
                "held_light": holds or held(light, seen.pose, *ends).held,
            }


def widths(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return how much wider the true object is than planned, along the line of each first grasp."""
    lines = []
    met = [row for row in rows if row["rank"] == 0 and np.isfinite(row["true_mm"])]
    for name, own in [*grouped(met, "object"), *grouped(met, "view"), ("all", met)]:
        wider = np.array([row["true_mm"] - row["planned_mm"] for row in own])
        covered = np.mean([row["true_mm"] <= row["at_most_mm"] for row in own])
        spare = np.mean([row["at_most_mm"] - row["planned_mm"] for row in own])
        quantiles = ", ".join(f"{value:.1f}" for value in np.quantile(wider, [0.1, 0.9]))
        lines.append(
            {
                "first grasps": str(name),
                "number": str(len(own)),
                "true minus planned, median [mm]": f"{np.median(wider):.1f}",
                "tenth, nineth decile [mm]": quantiles,
                "inside of the bound": f"{covered:.2f}",
                "bound minus planned, mean [mm]": f"{spare:.1f}",
            }
        )
    return lines


def carried(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return which share of the grasps that hold, that fail by the weight, and that fail with any, is flagged."""

    def share(own: Sequence[Row]) -> str:
        return f"{sum(row['cannot_carry'] for row in own)} of {len(own)}" if own else ""

    lines = []
    for name, own in [*grouped(rows, "object"), ("all", list(rows))]:
        kinds: Mapping[str, Sequence[Row]] = {
            "hold": [row for row in own if row["held"]],
            "fail by the weight": [row for row in own if row["held_light"] and not row["held"]],
            "fail with any": [row for row in own if not row["held_light"]],
        }
        lines.append({f"flagged, of the {COUNT} best": str(name)} | {kind: share(some) for kind, some in kinds.items()})
    return lines


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--objects", type=Path, help="folder of objects (default: ycb in the folder of recordings)")
    parser.add_argument("--poses", type=int, default=8, help="of each object")
    parser.add_argument("--rows", type=Path, help="write one row for each grasp to this CSV")
    parser.add_argument("--renew", action="store_true", help="write the committed tables")
    options = parser.parse_args()
    ensure_libusb()
    items = read_items(options.objects or Path(options.data or "") / "ycb")
    rows = [row for item in items for row in rows_of(item, options.poses)]
    if options.rows:
        write_csv(options.rows, rows)
    tables = {"Widths": widths(rows), f"Grasps with the flag `{CANNOT_CARRY}`, with the true mass": carried(rows)}
    head = f"{len(items)} objects, {options.poses} poses each, two views."
    show_tables(tables, head, HERE / "STATED.md" if options.renew else None)


if __name__ == "__main__":
    main()
