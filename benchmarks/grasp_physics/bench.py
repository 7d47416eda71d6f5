# SPDX-License-Identifier: Apache-2.0
"""How often does the first grasp hold the object? See README.md."""

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import yaml

from benchmarks.common import add_data, print_rows, replace_marked, write_csv
from benchmarks.grasp_physics import report
from benchmarks.grasp_physics.camera import VIEWS
from benchmarks.grasp_physics.measure import ALL_METHODS, FRICTIONS, TIPS_MM, Conditions, Row, Task, measure
from benchmarks.grasp_physics.objects import read_items
from benchmarks.grasp_physics.simulation import OPENING_M
from foretouch.camera.device import ensure_libusb

HERE: Final = Path(__file__).parent
RESULTS: Final = HERE / "results.csv"
PICTURE: Final = HERE / "grasps.png"


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_options(parser)
    options = parser.parse_args()
    todo = tasks(options)
    if not todo:
        parser.error(f"--only: {', '.join(options.only)}: there is no such object")
    ensure_libusb()
    if options.frontier:
        from benchmarks.grasp_physics.frontier import run

        run(todo, options.vary, options.workers, renew=options.renew)
        return
    start = time.perf_counter()
    rows, used = measure(todo, options.workers), todo[0].conditions
    if options.rows:
        write_csv(options.rows, [asdict(row) for row in rows])
    print_all(rows, used)
    print(f"\n{len(rows)} grasps in {time.perf_counter() - start:.0f} s")
    if options.renew:
        renew(rows, todo, used)


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of all modes."""
    add_data(parser)
    parser.add_argument("--objects", type=Path, help="folder of objects (default: ycb in the folder of recordings)")
    parser.add_argument("--only", nargs="+", metavar="OBJECT", help="these objects alone")
    parser.add_argument("--poses", type=int, default=8, help="of each object")
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=VIEWS)
    parser.add_argument("--methods", nargs="+", choices=ALL_METHODS, default=ALL_METHODS, metavar="METHOD",
                        help=f"out of {', '.join(ALL_METHODS)}")  # fmt: skip
    parser.add_argument("--tip-mm", nargs="+", type=float, default=TIPS_MM[:1], help="radius of the tips [mm]")
    parser.add_argument("--friction", nargs="+", type=float, default=FRICTIONS[:1], help="between tip and object")
    parser.add_argument("--opening-mm", type=float, default=1e3 * OPENING_M, help="how far the hand opens [mm]")
    parser.add_argument("--all", action="store_true", help="also the other tips and frictions of the table")
    parser.add_argument("--workers", type=int, choices=(1, 2), default=1)
    parser.add_argument("--cache", type=Path, help="folder where images are kept")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="SETTING=VALUE", help="of the pipeline, such as grasp.max_points=1000"
    )
    parser.add_argument("--rows", type=Path, help="write one row for each grasp to this CSV")
    parser.add_argument("--renew", action="store_true", help="write the committed tables and pictures")
    parser.add_argument("--frontier", action="store_true", help="held against time, over settings of the planner")
    parser.add_argument("--vary", nargs="+", default=["grasp.max_points=500,1000,2000,4000,8000"], metavar="SETTING=A,B,…",
                        help="for --frontier: settings of the pipeline, all combinations")  # fmt: skip


def conditions(options: argparse.Namespace) -> tuple[Conditions, ...]:
    """The first tip with each friction, and the other tips with the first friction."""
    tips, frictions = (TIPS_MM, FRICTIONS) if options.all else (options.tip_mm, options.friction)
    pairs = [(tips[0], friction) for friction in frictions] + [(tip, frictions[0]) for tip in tips[1:]]
    return tuple(Conditions(tip, friction, options.opening_mm) for tip, friction in pairs)


def tasks(options: argparse.Namespace) -> list[Task]:
    """One task for each object."""
    items = read_items(options.objects or Path(options.data or "") / "ycb")
    chosen = options.poses, tuple(options.views), tuple(options.methods), conditions(options), options.cache
    settings = dict(parsed(text) for text in options.set)
    return [Task(item, *chosen, settings) for item in items if not options.only or item.name in options.only]


def parsed(text: str) -> tuple[str, Any]:
    """Name and value of a setting given as `name=value`, the value as in YAML."""
    name, _, value = text.partition("=")
    return name, yaml.safe_load(value)


def print_all(rows: list[Row], used: tuple[Conditions, ...]) -> None:
    """All tables on the terminal."""
    print_rows(report.by_method(rows, used[0]))
    for lines in (report.by_reason(rows, used[0]), report.by_name(rows, used[0])):
        print()
        print_rows(lines)
    if len(used) > 1:
        print("\nheld / strict")
        print_rows(report.by_conditions(rows, used))
    print(f"\n{report.agreement(rows)}")


def renew(rows: list[Row], todo: list[Task], used: tuple[Conditions, ...]) -> None:
    """Write the table, the page and the picture."""
    from benchmarks.grasp_physics.figure import draw

    write_csv(RESULTS, report.committed(rows, used))
    first = used[0]
    text = [
        f"{len(todo)} objects, {todo[0].poses} poses each, tips of {first.tip_mm:g} mm radius, friction {first.friction:g}, opening {first.opening_mm:g} mm:",
        report.table(report.by_method(rows, first)),
        "What became of the grasps, both views:",
        report.table(report.by_reason(rows, first)),
        "Held, by object, both views:",
        report.table(report.by_name(rows, first)),
        "Held / strict under other conditions, both views:",
        report.table(report.by_conditions(rows, used)),
        report.agreement(rows),
    ]
    replace_marked(HERE / "README.md", "\n\n".join(part.strip() for part in text))
    draw(rows, todo, PICTURE)


if __name__ == "__main__":
    main()
