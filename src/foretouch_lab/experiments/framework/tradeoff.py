# SPDX-License-Identifier: Apache-2.0
"""Areas of `foretouch tradeoff`: experiments that measure skills of many variants of one component, and time them.

Cells measure skills, each in its own process. Once they have run, all variants are timed in one process and in one
random order. The table, `tradeoff.csv`, has a row for each variant and size of request, with the state of the machine,
idle or loaded; a variant that cannot run here has one row with the reason. To add an area, add a module `tradeoff_<area>` to
`foretouch_lab.experiments` that holds an `EXPERIMENT`.

On the frontier of skill and time are the variants that no other beats in both. Where variants were compared in pairs,
those that do not differ significantly from the same most skilful one count as equal: of these, the fastest is on it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, ForetouchError, none_of
from foretouch.models.timing import MachineLoad, cpu_name, time_calls
from foretouch.report.panels import Axes, new_figure, save_small
from foretouch_lab.experiments.framework.experiment import (
    Cell,
    Experiment,
    Row,
    Table,
    find_experiment,
    list_experiments,
)

_PREFIX: Final = "tradeoff_"
_TIMES: Final = {"ms_p50": "p50 [ms]", "ms_p95": "p95 [ms]", "ms_p99": "p99 [ms]", "cpu_ms": "CPU [ms]"}
_LOWEST: Final = 0.25  # how far below the frontier's skills the axes reach, as a share of their range


@dataclass(frozen=True, kw_only=True)
class TradeoffSettings(Settings):
    """Settings of every area."""

    timing_s: float = setting(60.0, "Time of all timings together", bounds=(0.1, 3600.0))
    pause_s: float = setting(
        0.0, "Time asleep before each call, as in a graph that waits for clouds", bounds=(0.0, 10.0)
    )
    requests: tuple[int, ...] = setting((1,), "Sizes of the requests that are timed", minimum=1)


class Variant(NamedTuple):
    """One setting of the component that is measured: the shipped one, or one that differs from it."""

    name: str  # unique, and short: it is written beside its point in the picture
    factor: str  # what differs: `shipped`, `reference`, the name of one setting, or two joined by ` x `
    values: Mapping[str, Any]  # plain JSON data from which the area makes it


class Panel(NamedTuple):
    """One diagram of the picture: the skill in a column against the time of requests of one size."""

    skill: str
    request: int
    title: str


Timed = tuple[
    Callable[[int], object], float
]  # a call with the size of a request, and how many such calls make the whole


@dataclass(frozen=True, kw_only=True)
class Area(Experiment):
    """Declaration of one area. Its settings are `TradeoffSettings`, and its presets are `small` and `full`.

    `tabulate` returns one row for each variant with the columns `variant` and, for each of `skills`, `<skill>`,
    `<skill>_low` and `<skill>_high` (its spread), those of `equal_columns` where variants are compared in pairs, and
    errors as the area likes. A variant without a row has times alone.

    Attributes:
        variants: All variants of a preset's settings.
        timed: (variant, settings, data) to a call that is timed, and the factor of its time; called once for each. Raises a
            `ForetouchError` if the variant cannot run here, such as for a library that is not installed.
        skills: Columns of skills, each with its meaning.
        panels: Diagrams of the picture.
    """

    variants: Callable[[Any], Iterable[Variant]]
    timed: Callable[[Variant, Any, Any], Timed]
    skills: Mapping[str, str]
    panels: Sequence[Panel]
    summarise: Callable[[Sequence[Row]], Sequence[Table]] = lambda _: ()
    results: str = "tradeoff.csv"
    order: int = 900

    @property
    def area(self) -> str:
        """Name on the command line of `foretouch tradeoff`."""
        return self.name.removeprefix(_PREFIX)

    @property
    def command(self) -> str:
        """Words that run it."""
        return f"foretouch tradeoff {self.area}"

    def resolve(self, preset: str, overrides: Mapping[str, Any]) -> Any:
        """As `Experiment.resolve`; a `ConfigError` too if two variants have the same name."""
        settings = super().resolve(preset, overrides)
        names = [one.name for one in self.variants(settings)]
        if len(set(names)) < len(names):
            raise ConfigError(f"{self.name}: variants: {max(names, key=names.count)!r} occurs twice")
        return settings

    def finish(
        self, settings: Any, data: Any, rows: list[Row], _out: Path, progress: Callable[[int, int], None], /
    ) -> list[Row]:
        """Add the times."""
        found = {row["variant"]: row for row in rows}
        names = [name for name in next(iter(rows), {}) if name != "variant"]
        return [
            {"variant": variant.name, "factor": variant.factor}
            | {name: found.get(variant.name, {}).get(name) for name in names}
            | row
            for variant, row in _time_variants(self, settings, data, progress)
        ]

    def facts(self, rows: Sequence[Row], /) -> dict[str, Any]:
        """Variants that could not run, with the reasons, and those on the frontier of each panel."""
        lines = {one.title: frontier(_of_request(rows, one.request), one.skill) for one in self.panels}
        return {
            "area": self.area,
            "skipped": {row["variant"]: row["skipped"] for row in rows if row["skipped"]},
            "frontier": {title: [row["variant"] for row in line] for title, line in lines.items()},
        }

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """What the area summarises, frontiers, and the machine."""
        rows = _best_state(rows)
        return [*self.summarise(rows), *frontier_tables(self.panels, rows), _machine(rows)]

    def draw(self, rows: Sequence[Row], folder: Path) -> list[Path]:
        """Draw `tradeoff.png`: a diagram for each panel that has rows, with the names on its frontier."""
        panels = [one for one in self.panels if frontier(_of_request(rows, one.request), one.skill)]
        if not panels:
            return []
        factors = list(dict.fromkeys(row["factor"] for row in rows))
        figure = new_figure(9.0, 0.5 + 4.4 * len(panels))
        for axes, panel in zip(figure.subplots(len(panels), squeeze=False).ravel(), panels, strict=True):
            _draw_panel(axes, panel, self.skills[panel.skill], _of_request(rows, panel.request), factors)
        return [save_small(figure, folder / "tradeoff.png")]


def list_areas() -> list[Area]:
    """The areas of this package, sorted by name."""
    return sorted((one for one in list_experiments() if isinstance(one, Area)), key=lambda one: one.name)


def find_area(name: str) -> Area:
    """Find an area by name, or by the dotted name of a user's module that holds an `EXPERIMENT`.

    Raises:
        ConfigError: If there is none.
    """
    if "." in name and isinstance(found := find_experiment(name), Area):
        return found
    areas = {one.area: one for one in list_areas()}
    if name not in areas:
        raise ConfigError(f"tradeoff: {none_of(name, areas)}")
    return areas[name]


def variant_cells(variants: Callable[[Any], Iterable[Variant]]) -> Callable[[Any, Any], list[Cell]]:
    """`cells` of an area with a cell for each variant."""
    return lambda settings, _: [
        Cell(f"{k:03}", {"variant": one.name, **one.values}) for k, one in enumerate(variants(settings))
    ]


def _time_variants(
    area: Area, settings: Any, data: Any, progress: Callable[[int, int], None]
) -> list[tuple[Variant, Row]]:
    """Make each variant ready, then time all together: a row for each variant and size."""
    from threadpoolctl import threadpool_limits

    ready: dict[str, Timed] = {}
    skipped: dict[str, str] = {}
    variants = list(area.variants(settings))
    with threadpool_limits(1):
        for variant in variants:
            try:
                ready[variant.name] = area.timed(variant, settings, data)
            except ForetouchError as err:
                skipped[variant.name] = str(err)
        load = MachineLoad()
        calls = {name: call for name, (call, _) in ready.items()}
        times = time_calls(calls, sorted(settings.requests), settings.timing_s, progress, settings.pause_s)
    state = load.row()
    machine = {"state": state["state"], "other_cores": state["other_cores"], "cpu": cpu_name()}
    rows: list[tuple[Variant, Row]] = []
    for variant in variants:
        facts = {**machine, "skipped": skipped.get(variant.name)}
        for request in sorted(settings.requests):
            if (own := times.get((variant.name, request))) is not None:
                values = [*np.percentile(own[:, 0], (50, 95, 99)), np.median(own[:, 1])]
                measured = 1e3 * ready[variant.name][1] * np.array(values)
                row = {"request": request, "calls": len(own), **dict(zip(_TIMES, measured.tolist(), strict=True))}
                rows.append((variant, {**row, **facts}))
        if variant.name in skipped:
            rows.append((variant, {**dict.fromkeys(("request", "calls", *_TIMES)), **facts}))
    return rows


# The frontier.


def _best_state(rows: Sequence[Row]) -> list[Row]:
    """Rows of the idle machine, if the table holds any, else all."""
    return [row for row in rows if row["state"] == "idle"] or list(rows)


def _of_request(rows: Sequence[Row], request: int) -> list[Row]:
    """Rows of one size of request, of the best state of the machine."""
    return [row for row in _best_state(rows) if row["request"] == request]


def time_column(rows: Sequence[Row]) -> str:
    """Wall time if the machine was idle, else processor time, which other processes disturb less."""
    return "ms_p50" if all(row["state"] == "idle" for row in rows) else "cpu_ms"


def frontier(rows: Sequence[Row], skill: str) -> list[Row]:
    """Rows that no other beats in both skill and time, by ascending time.

    Args:
        rows: Of one size of request and one state of the machine.
        skill: Column; rows without it are ignored.
    """
    column, found = time_column(rows), [row for row in rows if row.get(skill) is not None]

    def level(row: Row) -> float:
        """Skill of the most skilful one that it equals; its own where they were not compared."""
        best = row.get(f"{skill}_equals")
        return float(next((one[skill] for one in found if one["variant"] == best), row[skill]))

    result: list[Row] = []
    for row in sorted(found, key=lambda one: (one[column], -level(one))):
        if not result or level(row) > level(result[-1]):
            result.append(row)
    return result


def frontier_tables(panels: Sequence[Panel], rows: Sequence[Row]) -> list[Table]:
    """For each panel that has rows, the settings on the frontier with their skill and times; a `*` marks the shipped one."""
    found = []
    for panel in panels:
        body = [
            [
                row["variant"] + " *" * (row["factor"] == "shipped"),
                interval(row, panel.skill),
                *(f"{row[name]:.3g}" for name in _TIMES),
            ]
            for row in frontier(_of_request(rows, panel.request), panel.skill)
        ]
        if body:
            found.append(Table(panel.title, ["frontier", "skill", *_TIMES.values()], body))
    return found


def interval(row: Row, name: str) -> str:
    """A skill with its interval, such as `-0.021 [-0.05, 0.01]`; nothing where it was not measured."""
    if row.get(name) is None:
        return ""
    low, high = row.get(f"{name}_low"), row.get(f"{name}_high")
    return f"{row[name]:.3f}" + ("" if low is None or high is None else f" [{low:.2f}, {high:.2f}]")


def _machine(rows: Sequence[Row]) -> Table:
    """Which settings could not run, and on what machine the others were timed."""
    first, wall = rows[0], time_column([row for row in rows if not row["skipped"]]) == "ms_p50"
    machine = f"{first['cpu']}, one thread, {first['state']}: other processes used {first['other_cores']:.2f} cores"
    skipped = [f"Skipped: {row['variant']}: {row['skipped']}." for row in rows if row["skipped"]]
    notes = [*skipped, f"Measured on {machine}. Frontiers are of the median {'wall' if wall else 'processor'} time."]
    return Table("Machine", [], [], notes)


def _draw_panel(axes: Axes, panel: Panel, meaning: str, rows: Sequence[Row], factors: Sequence[str]) -> None:
    column, skill = time_column(rows), panel.skill
    skilled, line = [row for row in rows if row.get(skill) is not None], frontier(rows, skill)
    named = [row for row in skilled if row in line or row["factor"] == "shipped"]
    low, high = min(row[skill] for row in named), max(row[skill] for row in skilled)
    floor = low - _LOWEST * ((high - low) or 0.05)  # what is far worse is drawn there, as an arrow
    axes.step([row[column] for row in line], [row[skill] for row in line], where="post", color="black", linewidth=1)
    for factor in dict.fromkeys(row["factor"] for row in skilled):
        own = [row for row in skilled if row["factor"] == factor]
        number = factors.index(factor)
        marker, size = ("*", 11) if factor == "shipped" else ("os^D"[number // 10 % 4], 5)
        heights, colour = [max(row[skill], floor) for row in own], f"C{number % 10}"
        axes.plot([row[column] for row in own], heights, marker, markersize=size, color=colour, label=factor)
    below = [row[column] for row in skilled if row[skill] < floor]
    axes.plot(below, [floor] * len(below), "kv")
    for row in line:
        if row.get(f"{skill}_low") is not None:
            ends = [max(row[f"{skill}_low"], floor), row[f"{skill}_high"]]
            axes.plot([row[column]] * 2, ends, color=f"C{factors.index(row['factor']) % 10}", linewidth=0.6)
    for row in named:
        axes.annotate(row["variant"], (row[column], row[skill]), (4, -9), textcoords="offset points", fontsize=7)
    axes.set_xscale("log")
    for one in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        one(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
    axes.set_ylim(floor - 0.1 * (high - floor), high + 0.2 * (high - floor))
    axes.grid(visible=True, which="both", alpha=0.2)
    axes.set_xlabel("wall time, median [ms]" if column == "ms_p50" else "processor time, median (loaded machine) [ms]")
    axes.set_ylabel(meaning)
    axes.set_title(panel.title, fontsize=10)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.01, 1.0))
