# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs in time: the share of grasps that hold against the time of a plan, over methods and settings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from benchmarks.common import print_rows, replace_marked, write_csv
from benchmarks.grasp_physics.measure import Row, Task, measure
from benchmarks.grasp_physics.methods import METHODS, RULE
from benchmarks.grasp_physics.report import share, table
from foretouch.report.panels import new_figure, save_small

HERE: Final = Path(__file__).parent
CSV, PICTURE, PAGE = HERE / "frontier.csv", HERE / "frontier.png", HERE / "FRONTIER.md"
REPEATS: Final = 3  # of each plan; the least time counts
CLOSE: Final = 0.02  # so much less than the best may the knee hold


@dataclass(frozen=True)
class Point:
    """One method with its settings."""

    method: str
    settings: str
    held: float  # share, all views
    interval: str  # the share, with its interval over objects
    strict: float
    ms: float  # median over images
    p95_ms: float

    @property
    def name(self) -> str:
        """Method and settings."""
        return f"{self.method} {self.settings}".strip()


def run(tasks: Sequence[Task], vary: Sequence[str], workers: int, *, renew: bool) -> None:
    """Measure and print; where asked, write table, page and picture."""
    points = sorted(_points(tasks, vary, workers), key=lambda point: point.ms)
    knee = knee_of(points)
    best = max((point for point in points if point.method != RULE), key=lambda point: point.held, default=knee)
    sentence = (
        f"The knee is {knee.name}: {knee.held:.2f} held in {knee.ms:.1f} ms. The best, {best.name}, holds {best.held:.2f} in {best.ms:.1f} ms. "
        f"The knee is the fastest setting of a method of foretouch that holds at most {CLOSE:g} less than the best of them."
    )
    lines = [
        {"method": point.method, "settings": point.settings, "held": point.interval, "strict": f"{point.strict:.2f}"}
        | {"median [ms]": f"{point.ms:.2f}", "p95 [ms]": f"{point.p95_ms:.2f}"}
        | {"place": "knee" if point is knee else "frontier" if on_frontier(point, points) else ""}
        for point in points
    ]
    print_rows(lines)
    print(f"\n{sentence}")
    if renew:
        write_csv(CSV, [{k: v for k, v in line.items() if not k.endswith("[ms]")} for line in lines])
        replace_marked(PAGE, f"{table(lines)}\n{sentence}")
        draw(points, knee, PICTURE)


def combinations(vary: Sequence[str]) -> list[dict[str, Any]]:
    """All combinations of settings given as `name=a,b`, values as in YAML."""
    named = [text.partition("=") for text in vary]
    values = [[(name, yaml.safe_load(value)) for value in given.split(",")] for name, _, given in named]
    return [dict(chosen) for chosen in product(*values)]


def _points(tasks: Sequence[Task], vary: Sequence[str], workers: int) -> Iterator[Point]:
    chosen = [name for name in tasks[0].methods if name in METHODS]
    ours = tuple(name for name in chosen if name != RULE)
    every = [({}, (RULE,))] * (RULE in chosen) + [(settings, ours) for settings in combinations(vary) if ours]
    for settings, methods in every:
        varied = [
            replace(task, methods=methods, settings={**task.settings, **settings}, repeats=REPEATS) for task in tasks
        ]
        rows = measure(varied, workers)
        text = ", ".join(f"{name.rpartition('.')[2]} {value}" for name, value in settings.items())
        for method in methods:
            yield _point(method, text, [row for row in rows if row.method == method])


def _point(method: str, settings: str, rows: Sequence[Row]) -> Point:
    held, strict = (float(np.mean([getattr(row, what) for row in rows])) for what in ("held", "strict"))
    median, p95 = (float(np.nanquantile([row.ms for row in rows], q)) for q in (0.5, 0.95))
    return Point(method, settings, held, share(rows, lambda row: row.held), strict, median, p95)


def on_frontier(point: Point, points: Sequence[Point]) -> bool:
    """Whether no other holds as often in less time, or more often in the same time."""
    return not any(
        other.held >= point.held and other.ms <= point.ms and (other.held, other.ms) != (point.held, point.ms)
        for other in points
    )


def knee_of(points: Sequence[Point]) -> Point:
    """The fastest setting of a method of foretouch that holds hardly less often than the best of them."""
    ours = [point for point in points if point.method != RULE] or list(points)
    best = max(point.held for point in ours)
    return min((point for point in ours if point.held >= best - CLOSE), key=lambda point: point.ms)


def draw(points: Sequence[Point], knee: Point, path: Path) -> None:
    """Write the picture: a line for each method, its settings from fast to slow."""
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    for method in dict.fromkeys(point.method for point in points):
        mine = [point for point in points if point.method == method]
        axis.plot([point.ms for point in mine], [point.held for point in mine], "o-", label=method)
    axis.plot(knee.ms, knee.held, "o", markersize=14, fillstyle="none", color="black", label=f"knee: {knee.name}")
    axis.set(xlabel="time of a plan, median [ms]", ylabel="first grasps that hold", ylim=(0.0, 1.0))
    axis.set_xlim(left=0.0)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    save_small(figure, path)
