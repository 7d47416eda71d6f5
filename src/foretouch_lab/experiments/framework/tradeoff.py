# SPDX-License-Identifier: Apache-2.0
"""Areas of `foretouch tradeoff`: experiments that measure skills of many variants of one component, and time them.

An area is a list of variants, a function that measures a skill of all of them, and one that makes a variant ready to be
timed. Each skill is a cell, in its own process; then all variants are timed in one process and in one random order. The
table, `tradeoff.csv`, has a row for each variant and size of request, with the state of the machine, idle or loaded. To
add an area, add a module `tradeoff_<area>` to `foretouch_lab.experiments` that holds an `EXPERIMENT`.

On the frontier of skill and time are the variants that no other beats in both. Those that do not differ significantly
from the most skilful one count as equal to it: of these, the fastest is on it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, none_of
from foretouch.report.panels import Axes, new_figure, save_small
from foretouch_lab.experiments.framework.experiment import (
    Cell,
    Experiment,
    Row,
    Table,
    find_experiment,
    list_experiments,
)
from foretouch_lab.experiments.framework.timing import MachineLoad, cpu_name, time_calls
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

_PREFIX: Final = "tradeoff_"
_TIMES: Final = ("ms_p50", "ms_p95", "ms_p99", "cpu_ms", "cpu_ms_p95")
_OLD: Final = {"perception": "scene", "touch": "model"}
"""Names under which areas are found, too."""
_YARDSTICK: Final = "yardstick"
_YARDSTICK_TEXT: Final = "SciPy's k-d tree finds the 10 nearest of 20,000 points for 1,000 of them"
_LOWEST: Final = 0.25  # how far below the frontier's skills the axes reach, as a share of their range


@dataclass(frozen=True, kw_only=True)
class TradeoffSettings(Settings):
    """Settings of every area."""

    skills: tuple[str, ...] = setting((), "Columns of skills to measure; all by default")
    timing_s: float = setting(60.0, "Time of all timings together", bounds=(0.1, 3600.0))
    pause_s: float = setting(
        0.0, "Time asleep before each call, as in a graph that waits for clouds", bounds=(0.0, 10.0)
    )
    requests: tuple[int, ...] = setting((1,), "Sizes of the requests that are timed", minimum=1)
    bootstrap: BootstrapConfig = BootstrapConfig()


class Variant(NamedTuple):
    """One setting of the component that is measured: the shipped one, or one that differs from it."""

    name: str  # unique, and short: it is written beside its point in the picture
    factor: str  # what differs: `shipped`, `reference`, the name of one setting, or two joined by ` x `
    values: Mapping[str, Any] = {}  # from which the area makes it


class Panel(NamedTuple):
    """One diagram of the picture: a skill against the time of requests of one size."""

    skill: str  # its column
    request: int
    title: str
    meaning: str = "mean skill, 95 % interval"


Timed = tuple[Callable[[int], object], float]
"""A call with the size of a request, and how many such calls make the whole."""


@dataclass(frozen=True, kw_only=True)
class Area(Experiment):
    """Declaration of one area (see `make_area`).

    Attributes:
        variants: All variants; of those without a skill only the time is measured.
        timed: (variant, settings, data) to a call that is timed, and the factor of its time; called once for each.
        panels: Diagrams of the picture.
    """

    variants: Sequence[Variant]
    timed: Callable[[Variant, Any, Any], Timed]
    panels: Sequence[Panel]

    @property
    def area(self) -> str:
        """Name on the command line of `foretouch tradeoff`."""
        return self.name.removeprefix(_PREFIX)

    @property
    def command(self) -> str:
        """Words that run it."""
        return f"foretouch tradeoff {self.area}"

    def finish(
        self, settings: Any, data: Any, rows: list[Row], _out: Path, progress: Callable[[int, int], None], /
    ) -> list[Row]:
        """Time all variants: rows with their skills."""
        skills = {row["variant"]: row for row in rows}
        names = [name for name in dict.fromkeys(name for row in rows for name in row) if name != "variant"]
        return [
            {
                "variant": variant.name,
                "factor": variant.factor,
                **dict.fromkeys(names),
                **skills.get(variant.name, {}),
                **row,
            }
            for variant, row in _time_variants(self, settings, data, progress)
        ]

    def facts(self, rows: Sequence[Row], /) -> dict[str, Any]:
        """Return variants on the frontier of each panel."""
        lines = {panel.title: [row["variant"] for row in frontier(rows, panel)] for panel in self.panels}
        return {"area": self.area, "frontier": lines}

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """Return what the area summarises, and a table of the skills and times of all variants."""
        rows = _best_state(rows)
        skills = list(dict.fromkeys(panel.skill for panel in self.panels if panel.skill in rows[0]))
        best: dict[str, set[str]] = {skill: set() for skill in skills}
        for panel in self.panels:
            if panel.skill in best:
                best[panel.skill].update(row["variant"] for row in frontier(rows, panel))
        requests = sorted({row["request"] for row in rows if row["request"]})
        times = {(row["variant"], row["request"]): times_text(row, rows) for row in rows}
        body = [
            [
                row["variant"] + (" *" if row["factor"] == "shipped" else ""),
                *(f"{'• ' if row['variant'] in best[skill] else ''}{_interval(row, skill) or '–'}" for skill in skills),
                *(times.get((row["variant"], request), "–") for request in requests),
            ]
            for row in {row["variant"]: row for row in rows}.values()
        ]
        first, wall = rows[0], _time_column(rows) == "ms_p50"
        machine = f"{first['cpu']}, one thread, {first['state']}: other processes used {first['other_cores']:.2f} cores"
        notes = [
            f"Times of requests of these sizes: {'p50, p95, p99 of the wall time' if wall else 'median of the processor time'}.",
            "*: as shipped; •: on the frontier of this skill and the time of a request.",
            f"Measured on {machine}.",
        ]
        if first.get("yardstick_ms"):
            yard = f"{first['yardstick_ms']:.3g} ms of wall and {first['yardstick_cpu_ms']:.3g} ms of processor time"
            notes.append(f"Yardstick: {_YARDSTICK_TEXT} in {yard} (medians, in turns with the calls above).")
        head = ["", *skills, *(f"{request} [ms]" for request in requests)]
        return [*self.summarise(rows), Table("Variants", head, body, notes)]

    def draw(self, rows: Sequence[Row], folder: Path) -> list[Path]:
        """Draw `tradeoff.png`: a diagram for each panel that has rows, with the names on its frontier."""
        panels = [panel for panel in self.panels if frontier(rows, panel)]
        if not panels:
            return []
        figure = new_figure(9.0, 0.5 + 4.4 * len(panels))
        for axes, panel in zip(figure.subplots(len(panels), squeeze=False).ravel(), panels, strict=True):
            _draw_panel(axes, panel, rows)
        return [save_small(figure, folder / "tradeoff.png")]


def make_area(
    accuracy: Callable[[str, Any, Any], Mapping[str, Row]], *, panels: Sequence[Panel], **others: Any
) -> Area:
    """Make an area.

    Args:
        accuracy: (column of a skill, settings, data) to the row of each variant, by name: `<skill>`, `<skill>_low` and
            `<skill>_high` (its spread), `<skill>_equals` (the most skilful variant, where this one does not differ
            significantly from it), and errors as the area likes.
        panels: Diagrams of the picture.
        others: Further attributes of `Area` and `Experiment`. The settings are `TradeoffSettings`, and the presets are
            `small` and `full`.
    """
    columns = list(dict.fromkeys(panel.skill for panel in panels))

    def cells(settings: Any, _data: Any) -> list[Cell]:
        if unknown := [skill for skill in settings.skills if skill not in columns]:
            raise ConfigError(f"skills: {none_of(unknown[0], columns)}")
        return [Cell(skill, {"measured": skill}) for skill in settings.skills or columns]

    def run(cell: Cell, settings: Any, data: Any) -> list[Row]:
        return [{"variant": name, **row} for name, row in accuracy(cell.values["measured"], settings, data).items()]

    def tabulate(_settings: Any, rows: Sequence[Row]) -> list[Row]:
        merged: dict[str, Row] = {}
        for row in rows:
            merged.setdefault(row["variant"], {}).update(row)
            del merged[row["variant"]]["measured"]
        return list(merged.values())

    given = {"settings": TradeoffSettings, "summarise": lambda _: (), "results": "tradeoff.csv", **others}
    timing = ("skills", "timing_s", "pause_s", "requests")
    return Area(cells=cells, run=run, tabulate=tabulate, panels=panels, resumable_settings=timing, **given)


def list_areas() -> list[Area]:
    """Return the areas of this package, sorted by name."""
    return [experiment for experiment in list_experiments() if isinstance(experiment, Area)]


def find_area(name: str) -> Area:
    """Find an area by name, or by the dotted name of a user's module that holds an `EXPERIMENT`.

    Raises:
        ConfigError: If there is none.
    """
    areas = {area.area: area for area in list_areas()}
    chosen = find_experiment(name) if "." in name else areas.get(_OLD.get(name, name))
    if not isinstance(chosen, Area):
        raise ConfigError(f"tradeoff: {none_of(name, areas)}")
    return chosen


def _time_variants(
    area: Area, settings: Any, data: Any, progress: Callable[[int, int], None]
) -> list[tuple[Variant, Row]]:
    """Make each variant ready, then time all together: a row for each variant and size."""
    from threadpoolctl import threadpool_limits

    sizes = sorted(settings.requests)
    with threadpool_limits(1):
        ready = {variant.name: area.timed(variant, settings, data) for variant in area.variants}
        load = MachineLoad()
        calls = {**{name: call for name, (call, _) in ready.items()}, _YARDSTICK: yardstick()}
        times = time_calls(calls, sizes, settings.timing_s, progress, settings.pause_s)
    wall_ms, cpu_ms = (1e3 * np.median(times[_YARDSTICK, sizes[0]], axis=0)).tolist()
    machine = {**load.row(), "cpu": cpu_name(), "yardstick_ms": wall_ms, "yardstick_cpu_ms": cpu_ms}
    rows: list[tuple[Variant, Row]] = []
    for variant, request in product(area.variants, sizes):
        if (own := times.get((variant.name, request))) is not None:
            measured = [*np.percentile(own[:, 0], (50, 95, 99)), *np.percentile(own[:, 1], (50, 95))]
            values = (1e3 * ready[variant.name][1] * np.array(measured)).tolist()
            row = {"request": request, "calls": len(own), **dict(zip(_TIMES, values, strict=True))}
            rows.append((variant, {**row, **machine}))
    return rows


def yardstick() -> Callable[[int], object]:
    """Return a call whose time shows how fast a machine is (see `_YARDSTICK_TEXT`)."""
    from scipy.spatial import cKDTree

    points = np.random.default_rng(0).uniform(size=(20_000, 3))
    tree = cKDTree(points)
    return lambda _: tree.query(points[:1000], 10)


def measure_here(
    area: Area, settings: Any, data: Any, rows: Sequence[Row], progress: Callable[[int, int], None]
) -> Table:
    """Time what is on the frontier of a table, and what is shipped, on this machine.

    Args:
        area: The area.
        settings: Of the timings.
        data: Of the area.
        rows: Of the table.
        progress: Called with the number of calls done and of all.
    """
    wanted = {row["variant"] for panel in area.panels for row in frontier(rows, panel)}
    chosen = [one for one in area.variants if one.name in wanted or one.factor == "shipped"]
    here = [
        row | {"variant": one.name}
        for one, row in _time_variants(replace(area, variants=chosen), settings, data, progress)
    ]
    there = {(row["variant"], row["request"]): row for row in _best_state(rows)}
    pairs = [(own, there[key]) for own in here if (key := (own["variant"], own["request"])) in there]
    late = late_time([*here, *there.values()])
    column = "ms_p50" if late == "ms_p95" else "cpu_ms"
    body = [
        [own["variant"], str(own["request"]), *(f"{row[name]:.3g}" for name in (column, late) for row in (other, own))]
        for own, other in pairs
    ]
    scale = f"yardstick_{column.removesuffix('_p50')}"
    text = f"The yardstick takes {here[0][scale] / next(iter(there.values()))[scale]:.2f} times as long here."
    kind = "wall time" if column == "ms_p50" else "processor time, since a machine was loaded"
    head = ["", "request", "p50 there [ms]", "p50 here [ms]", "p95 there [ms]", "p95 here [ms]"]
    return Table(f"The frontier of {area.area} on this machine: {kind}", head, body, [text])


def late_time(rows: Sequence[Row]) -> str:
    """Name the column of the time that 95 of 100 calls meet: the wall time, or the processor time if a machine was loaded."""
    return "ms_p95" if all(row["state"] == "idle" for row in rows) else "cpu_ms_p95"


def _best_state(rows: Sequence[Row]) -> list[Row]:
    """Return rows of the idle machine, if the table holds any, else all."""
    return [row for row in rows if row["state"] == "idle"] or list(rows)


def _time_column(rows: Sequence[Row]) -> str:
    """Return wall time if the machine was idle, else processor time, which other processes disturb less."""
    return "ms_p50" if all(row["state"] == "idle" for row in rows) else "cpu_ms"


def _of_panel(rows: Sequence[Row], panel: Panel) -> list[Row]:
    """Return rows of the skill and the size of request of a panel, of the best state of the machine."""
    return [row for row in _best_state(rows) if row["request"] == panel.request and row.get(panel.skill) is not None]


def frontier(rows: Sequence[Row], panel: Panel) -> list[Row]:
    """Return rows that no other beats in both skill and time, by ascending time.

    Args:
        rows: Of the table.
        panel: Whose skill and size of request count.
    """
    skill, shown = panel.skill, _of_panel(rows, panel)
    column, skills = _time_column(shown), {row["variant"]: float(row[skill]) for row in shown}

    def level(row: Row) -> float:
        """Return the skill of the one that it equals; its own where they were not compared."""
        return skills.get(row.get(f"{skill}_equals"), float(row[skill]))

    result: list[Row] = []
    for row in sorted(shown, key=lambda row: (row[column], -level(row))):
        if not result or level(row) > level(result[-1]):
            result.append(row)
    return result


def times_text(row: Row, rows: Sequence[Row]) -> str:
    """Return percentiles of the wall time, or the median of the processor time if the machine was loaded, with two digits."""
    keys = ("ms_p50", "ms_p95", "ms_p99") if _time_column(rows) == "ms_p50" else ("cpu_ms",)
    return ", ".join("–" if row[key] is None else f"{float(f'{row[key]:.2g}'):g}" for key in keys)


def _interval(row: Row, name: str) -> str:
    """Return a skill with its interval, such as `-0.021 [-0.05, 0.01]`; nothing where it was not measured."""
    if row.get(name) is None:
        return ""
    low, high = row.get(f"{name}_low"), row.get(f"{name}_high")
    return f"{row[name]:.3f}" + ("" if low is None or high is None else f" [{low:.2f}, {high:.2f}]")


def _draw_panel(axes: Axes, panel: Panel, rows: Sequence[Row]) -> None:
    """Draw the points of all variants in the colour of their factor, and the frontier with its intervals; its names stand beside it."""
    own = _of_panel(rows, panel)
    line = frontier(rows, panel)
    skill = panel.skill
    column, factors = _time_column(own), list(dict.fromkeys(row["factor"] for row in own))
    named = [row for row in own if row in line or row["factor"] == "shipped"]
    low, high = min(row[skill] for row in named), max(row[skill] for row in own)
    floor = low - _LOWEST * ((high - low) or 0.05)  # what is far worse is drawn there, as a triangle
    axes.step([row[column] for row in line], [row[skill] for row in line], where="post", color="black", linewidth=1)
    for number, factor in enumerate(factors):
        style: dict[str, Any] = {"color": f"C{number % 10}", "linestyle": "", "label": factor}
        mine = [row for row in own if row["factor"] == factor]
        marker = "*" if factor == "shipped" else "os^D"[number // 10 % 4]
        heights = [max(row[skill], floor) for row in mine]
        axes.plot([row[column] for row in mine], heights, marker=marker, markersize=10 if marker == "*" else 5, **style)
    below = [row[column] for row in own if row[skill] < floor]
    axes.plot(below, [floor] * len(below), "kv")
    for row in line:
        if row.get(f"{skill}_low") is not None:
            ends = [max(row[f"{skill}_low"], floor), row[f"{skill}_high"]]
            axes.plot([row[column]] * 2, ends, color="black", linewidth=0.5)
    named.sort(key=lambda row: row[column])
    for number, row in enumerate(named, 1):
        axes.annotate(str(number), (row[column], row[skill]), (4, -9), textcoords="offset points", fontsize=8)
    names = [f"{number}  {row['variant']}, {float(f'{row[column]:.3g}'):g} ms" for number, row in enumerate(named, 1)]
    axes.annotate("\n".join(names), (1.02, 0.0), xycoords="axes fraction", va="bottom", fontsize=7)
    axes.set_xscale("log")
    ratio = max(row[column] for row in own) / min(row[column] for row in own)
    labelled = "123456789" if ratio < 10.0 else "125" if ratio < 3000.0 else "1"  # first digits of ticks with a label
    for set_formatter in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        set_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in labelled else "")
    axes.set_ylim(floor - 0.1 * (high - floor), high + 0.2 * (high - floor))
    axes.grid(visible=True, which="both", alpha=0.2)
    axes.set_xlabel("wall time, median [ms]" if column == "ms_p50" else "processor time, median (loaded machine) [ms]")
    axes.set_ylabel(panel.meaning)
    axes.set_title(panel.title, fontsize=10)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.01, 1.0))
