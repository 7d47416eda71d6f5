# SPDX-License-Identifier: Apache-2.0
"""Figures of experiments: panels for the modalities, and intervals one below the other."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from foretouch.report.panels import Axes, Rows, new_figure, save_small
from foretouch.tactile import MODALITIES
from foretouch_lab.experiments.shared.tables import select


class Line(NamedTuple):
    """A line of panels, one for each modality."""

    height: float  # [inch]
    rows: Rows
    draw: Callable[[Axes, Rows], None]  # (axes, rows of the modality)
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    legend: bool = False  # whether the names of the first panel stand below the figure


def save_panels(
    path: Path, width: float, lines: Sequence[Line], *, modalities: Sequence[str] = MODALITIES, **shared: Any
) -> list[Path]:
    """Draw lines of panels below each other.

    Args:
        path: File to write.
        width: Of the figure [inch].
        lines: Lines of panels, one below the other.
        modalities: Panels of a line.
        shared: Axes that panels share, as in `subplots` of matplotlib.
    """
    figure = new_figure(width, sum(line.height for line in lines))
    heights = [line.height for line in lines]
    grid = figure.subplots(len(lines), len(modalities), squeeze=False, height_ratios=heights, **shared)
    for line, panels in zip(lines, grid, strict=True):
        for axes, modality in zip(panels, modalities, strict=True):
            line.draw(axes, select(line.rows, modality=modality))
            axes.set_title(f"{line.title}: {modality}" if line.title else modality, fontsize=9)
            axes.set_xlabel(line.x_label, fontsize=9)
        panels[0].set_ylabel(line.y_label)
        if line.legend:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", fontsize=8, ncols=len(labels))
    return [save_small(figure, path)]


def draw_intervals(
    axes: Axes, rows: Rows, column: str, names: Sequence[str], lowest: float, colour: Callable[[Mapping[str, Any]], str]
) -> None:
    """Draw skill and interval of each row, the names of a column one below the other.

    Args:
        axes: Where to draw.
        rows: Rows with `skill`, `skill_low` and `skill_high`.
        column: Column with the names.
        names: Names in order, the first on top.
        lowest: Skill at the left end; an arrow marks what is below.
        colour: Gives the colour of a row.
    """
    for row in rows:
        y, value = names.index(row[column]), row["skill"]
        shown = colour(row)
        if value < lowest:
            text = f"{value:.2f}" if abs(value) < 1.0 else f"{value:.1f}"
            axes.plot(lowest, y, marker="<", color=shown, clip_on=False)
            axes.annotate(text, (lowest, y), (6, 0), textcoords="offset points", va="center", fontsize=8)
            continue
        axes.plot(value, y, marker="o", color=shown, markersize=5)
        if row["skill_low"] is not None:
            axes.plot([max(row["skill_low"], lowest), row["skill_high"]], [y, y], color=shown)
    axes.axvline(0.0, color="grey", linewidth=0.8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=True, axis="x", alpha=0.3)
