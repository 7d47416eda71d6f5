# SPDX-License-Identifier: Apache-2.0
"""The frontier of skill and time of `tradeoff.csv`: variants that no other beats in both, as tables and picture.

Where variants were compared in pairs, those that do not differ significantly from the same most skilful one count as
equal: of these, the fastest is on the frontier.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.report.panels import Axes, new_figure, save_small
from foretouch_lab.experiments.framework.experiment import Row, Table

_LINE: Final = 0.05  # height of a label, as a share of the axes
_LOWEST: Final = 0.25  # how far below the frontier's skills the axes reach, as a share of their range
_COLUMNS: Final = {
    "ms_p50": "p50 [ms]",
    "ms_p95": "p95 [ms]",
    "ms_p99": "p99 [ms]",
    "cpu_ms": "CPU [ms]",
    "hot_cpu_ms": "CPU in a loop without pauses [ms]",
    "ratio": "times as fast as the reference",
}


class Panel(NamedTuple):
    """One diagram of the picture: the skill in a column against the time of requests of one size."""

    skill: str
    request: int
    title: str


def best_state(rows: Sequence[Row]) -> list[Row]:
    """Rows of the idle machine, if it was idle once, else of the loaded one."""
    return [row for row in rows if row["state"] == "idle"] or list(rows)


def of_request(rows: Sequence[Row], request: int) -> list[Row]:
    """Rows of one size of request, of the best state of the machine."""
    return [row for row in best_state(rows) if row["request"] == request]


def time_column(rows: Sequence[Row]) -> str:
    """Wall time if the machine was idle, else processor time, which other processes disturb less."""
    return "ms_p50" if all(row["state"] == "idle" for row in rows) else "cpu_ms"


def frontier(rows: Sequence[Row], skill: str) -> list[Row]:
    """Rows that no other beats in both skill and time, by ascending time.

    Args:
        rows: Of one size of request and one state of the machine.
        skill: Column; rows without it are ignored.
    """
    column, found = time_column(rows), known(rows, skill)
    result: list[Row] = []
    for row in sorted(found, key=lambda one: (one[column], -_level(one, skill, found))):
        if not result or _level(row, skill, found) > _level(result[-1], skill, found):
            result.append(row)
    return result


def known(rows: Sequence[Row], skill: str) -> list[Row]:
    """Rows that have a skill."""
    return [row for row in rows if row.get(skill) is not None]


def _level(row: Row, skill: str, rows: Sequence[Row]) -> float:
    """Skill of the most skilful one that it equals; its own where they were not compared."""
    best = row.get(f"{skill}_equals")
    return float(next((one[skill] for one in rows if one["variant"] == best), row[skill]))


def tables(panels: Sequence[Panel], rows: Sequence[Row]) -> list[Table]:
    """For each panel that has rows, the settings on the frontier with their skill and times; a `*` marks the shipped one."""
    found = []
    for panel in panels:
        line = frontier(of_request(rows, panel.request), panel.skill)
        columns = {name: text for name, text in _COLUMNS.items() if line and line[0].get(name) is not None}
        body = [
            [
                row["variant"] + " *" * (row["factor"] == "shipped"),
                interval(row, panel.skill),
                *("" if row[name] is None else f"{row[name]:.3g}" for name in columns),
            ]
            for row in line
        ]
        if body:
            found.append(Table(panel.title, ["frontier", "skill", *columns.values()], body))
    return found


def interval(row: Row, name: str) -> str:
    """A skill with its interval, such as `-0.021 [-0.05, 0.01]`; nothing where it was not measured."""
    if row.get(name) is None:
        return ""
    low, high = row.get(f"{name}_low"), row.get(f"{name}_high")
    return f"{row[name]:.3f}" + ("" if low is None or high is None else f" [{low:.2f}, {high:.2f}]")


def machine_notes(rows: Sequence[Row]) -> list[str]:
    """Which settings could not run, and on what machine the others were timed."""
    first, wall = rows[0], time_column([row for row in rows if not row["skipped"]]) == "ms_p50"
    machine = f"{first['cpu']}, one thread, {first['state']}: other processes used {first['other_cores']:.2f} cores"
    skipped = [f"Skipped: {row['variant']}: {row['skipped']}." for row in rows if row["skipped"]]
    return [*skipped, f"Measured on {machine}. Frontiers are of the median {'wall' if wall else 'processor'} time."]


def draw(panels: Sequence[Panel], skills: Mapping[str, str], rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw `tradeoff.png` into a folder: a diagram for each panel that has rows, with the names on its frontier beside it.

    `skills` are the columns of skills, each with its meaning.
    """
    panels = [panel for panel in panels if frontier(of_request(rows, panel.request), panel.skill)]
    if not panels:
        return []
    factors = list(dict.fromkeys(row["factor"] for row in rows))
    wide = min(len(panels), 2)
    tall = -(-len(panels) // wide)
    figure = new_figure(7.6 * wide, 0.5 + 4.4 * tall)
    grid = figure.subplots(tall, wide, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        _draw_panel(axes, panel, skills[panel.skill], of_request(rows, panel.request), factors)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    handles = {label: handle for axes in grid for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=7, fontsize=8)
    return [save_small(figure, folder / "tradeoff.png")]


def _draw_panel(axes: Axes, panel: Panel, meaning: str, rows: Sequence[Row], factors: Sequence[str]) -> None:
    column, skill = time_column(rows), panel.skill
    skilled, line = known(rows, skill), frontier(rows, skill)
    skills = [row[skill] for row in skilled]
    named = sorted(
        (row for row in skilled if row in line or row["factor"] == "shipped"), key=lambda row: float(row[skill])
    )
    low, high = named[0][skill], max(skills)
    span = max(high - low, _LOWEST * min(max(skills) - min(skills), 0.2)) or 0.05
    floor = low - _LOWEST * span
    axes.step([row[column] for row in line], [row[skill] for row in line], where="post", color="black", linewidth=1)
    for row in skilled:
        number, on_line, shipped = factors.index(row["factor"]), row in line, row["factor"] == "shipped"
        marker = "v" if row[skill] < floor else "*" if shipped else "os^Dv"[number // 10 % 5]
        style: dict[str, Any] = {"alpha": 1.0, "zorder": 3} if on_line else {"alpha": 0.55, "zorder": 2}
        axes.plot(row[column], max(row[skill], floor), linestyle="", marker=marker, color=f"C{number % 10}",
                  markersize=11 if shipped else 5, label=row["factor"], **style)  # fmt: skip
        if on_line and (lower := row.get(f"{skill}_low")) is not None:
            ends = [max(lower, floor), row[f"{skill}_high"]]
            axes.plot([row[column]] * 2, ends, color=f"C{number % 10}", linewidth=0.6)
    axes.set_xscale("log")
    axes.set_ylim(floor - 0.1 * span, high + 0.12 * span)
    for one in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        one(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
    axes.grid(visible=True, which="both", alpha=0.2)
    wall = column == "ms_p50"
    axes.set_xlabel("wall time, median [ms]" if wall else "processor time, median (loaded machine) [ms]")
    axes.set_ylabel(meaning)
    axes.set_title(panel.title, fontsize=10)
    name_points(axes, {f"{row['variant']}  {row[column]:.3g} ms": (row[column], row[skill]) for row in named}, _LINE)


def name_points(axes: Axes, points: Mapping[str, tuple[float, float]], gap: float) -> None:
    """Write names right of the axes, one below the other, each joined to its point by a line.

    The points (x, y) are in order of ascending y, so that neither names nor lines cross; `gap` is the height of a name
    as a share of the axes.
    """
    low, high = axes.get_ylim()
    places = spread([(y - low) / (high - low) for _, y in points.values()], gap)
    for (name, point), place in zip(points.items(), places, strict=True):
        axes.annotate(
            name, point, (1.04, place), textcoords="axes fraction", va="center", fontsize=7.5, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "linewidth": 0.4, "color": "grey", "shrinkA": 0, "shrinkB": 3, "relpos": (0.0, 0.5)},
        )  # fmt: skip


def spread(wanted: Sequence[float], gap: float) -> list[float]:
    """Places near the wanted ascending ones in [0, 1] that are at least a gap apart, if they fit."""
    from sklearn.isotonic import isotonic_regression

    count = len(wanted)
    offsets = min(gap, 1.0 / max(count - 1, 1)) * np.arange(count)
    nearest = isotonic_regression(np.asarray(wanted, np.float64) - offsets)  # with least squares
    return [float(place) for place in np.clip(nearest, 0.0, 1.0 - offsets[-1]) + offsets]
