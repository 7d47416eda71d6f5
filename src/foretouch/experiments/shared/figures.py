# SPDX-License-Identifier: Apache-2.0
"""Figures of experiments: panels for the modalities, lines over a column, and intervals one below the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from foretouch.experiments.shared.rows import grouped, select, unique
from foretouch.experiments.shared.scores import ALL_OBJECTS
from foretouch.report.panels import Rows, mark_off_scale, new_figure, save
from foretouch.tactile import MODALITIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOWEST_SKILL: Final = -1.5
"""Lower values are drawn as an arrow with their number at this edge of the figure."""

VERDICT_COLOURS: Final[Mapping[Any, str]] = {"better": "C2", "worse": "C3"}


def modality_panels(
    width: float, heights: Sequence[float], titles: Sequence[str] = ("",), **shared: Any
) -> tuple[Figure, list[list[tuple[Axes, str]]]]:
    """A figure with a line of panels for each height [inch], each a list of axes with their modalities."""
    figure = new_figure(width, sum(heights))
    grid = figure.subplots(len(heights), len(MODALITIES), squeeze=False, height_ratios=heights, **shared)
    for title, line in zip(titles, grid, strict=False):
        for axes, modality in zip(line, MODALITIES, strict=True):
            axes.set_title(f"{title}: {modality}" if title else modality, fontsize=9)
    return figure, [list(zip(line, MODALITIES, strict=True)) for line in grid]


def draw_series(
    axes: Axes,
    rows: Rows,
    x: str,
    series: str,
    names: Sequence[Any],
    *,
    values: str = "skill",
    places: Sequence[Any] | None = None,
    spread: float = 0.0,
    line: bool = True,
    lowest: float | None = None,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Draw a line for each name of a column, with intervals; an arrow marks values below `lowest`.

    Args:
        axes: The axes.
        rows: Rows with the columns `values`, and `<values>_low` and `<values>_high` where they have intervals.
        x: Column of the horizontal axis, whose values are set at equal distances.
        series: Column of the names.
        names: Names in the order of their colours.
        values: Column to draw.
        places: Values of `x` in order; by default those of the rows, sorted.
        spread: Distance between markers at one place, so that intervals do not hide each other.
        line: Whether the markers of a name are joined.
        lowest: Lower end of the vertical axis.
        styles: Arguments of matplotlib's `plot` by name.
    """
    places = sorted(set(unique(rows, x))) if places is None else places
    for number, name in enumerate(names):
        own = sorted(select(rows, **{series: name}), key=lambda row: places.index(row[x]))
        style = {"color": f"C{number}", "marker": "o", "markersize": 4, **(styles or {}).get(name, {})}
        centres = [places.index(row[x]) + spread * (number - (len(names) - 1) / 2) for row in own]
        axes.plot(centres, [row[values] for row in own], linestyle="-" if line else "", label=name, **style)
        for centre, row in zip(centres, own, strict=True):
            if lowest is not None and row[values] < lowest:
                axes.plot(centre, lowest, marker="v", color=style["color"], clip_on=False)
            if row.get(f"{values}_low") is not None:
                ends = [row[f"{values}_low"], row[f"{values}_high"]]
                axes.plot([centre, centre], ends, color=style["color"], linewidth=1)
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_xticks(range(len(places)), [str(place) for place in places])
    if lowest is not None:
        axes.set_ylim(lowest, 1.0)
    axes.grid(visible=True, alpha=0.3)


def draw_intervals(
    axes: Axes,
    rows: Rows,
    column: str,
    names: Sequence[str],
    *,
    values: str = "skill",
    lowest: float = _LOWEST_SKILL,
    colour: Callable[[Mapping[str, Any]], str] | None = None,
) -> None:
    """Draw value and interval of each row, those of a name beside each other and the names one below the other."""
    for row in rows:
        y, value = names.index(row[column]), row[values]
        shown = colour(row) if colour else f"C{y % 10}"
        if value < lowest:
            mark_off_scale(axes, lowest, y, f"{value:.2f}" if abs(value) < 1.0 else f"{value:.1f}", shown)
            continue
        axes.plot(value, y, marker="o", color=shown, markersize=5)
        if row[f"{values}_low"] is not None:
            axes.plot([max(row[f"{values}_low"], lowest), row[f"{values}_high"]], [y, y], color=shown)
    axes.axvline(0.0, color="grey", linewidth=0.8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=True, axis="x", alpha=0.3)


def legend_of(figure: Figure, axes: Axes, place: str, **how: Any) -> None:
    """The legend of one panel, beside the panels."""
    handles, labels = axes.get_legend_handles_labels()
    loc: Any = f"outside {place}"
    figure.legend(handles, labels, loc=loc, fontsize=8, **how)


def draw_skill_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `skill.png`: tables below each other, modalities side by side."""
    # The training mean has a skill of 0 by definition: it is the vertical line.
    shown = [row for row in select(rows, object=ALL_OBJECTS) if row["predictor"] != "training_mean"]
    shown = [row for row in shown if row["skill"] is not None]
    predictors, tables = unique(shown, "predictor"), grouped(shown, "table")
    heights = [0.9 + 0.25 * len(predictors)] * len(tables)
    figure, lines = modality_panels(12.0, heights, [name for name, _ in tables], sharex=True, sharey=True)
    for line, (_, own) in zip(lines, tables, strict=True):
        for axes, modality in line:
            draw_intervals(axes, select(own, modality=modality), "predictor", predictors)
    for axes in figure.axes[-len(MODALITIES) :]:
        axes.set_xlabel("skill (0: training mean)")
    return [save(figure, folder / "skill.png")]
