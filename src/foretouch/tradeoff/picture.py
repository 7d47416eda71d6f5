# SPDX-License-Identifier: Apache-2.0
"""Draw skill against time with the frontier, each of its points named beside the diagram."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.experiments.framework.experiment import Row
from foretouch.report.panels import new_figure, save
from foretouch.tradeoff.area import Area, Panel
from foretouch.tradeoff.frontier import frontier, of_request, time_column

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINE: Final = 0.05  # height of a label, as a share of the axes
_LOWEST: Final = 0.25  # how far below the frontier's skills the axes reach, as a share of their range


def draw_tradeoff(area: Area[Any, Any], rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw `tradeoff.png`: a diagram for each panel of the area that has rows."""
    panels = [panel for panel in area.panels if frontier(of_request(rows, panel.request), panel.skill)]
    if not panels:
        return []
    factors = list(dict.fromkeys(row["factor"] for row in rows))
    wide = min(len(panels), 2)
    tall = -(-len(panels) // wide)
    figure = new_figure(7.6 * wide, 0.5 + 4.4 * tall)
    grid = figure.subplots(tall, wide, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        _draw_panel(axes, area, of_request(rows, panel.request), panel, factors)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    handles = {label: handle for axes in grid for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=7, fontsize=8)
    return [save_small(figure, folder / "tradeoff.png")]


def save_small(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG with 128 colours, less than half as large."""
    from PIL import Image

    save(figure, path)
    with Image.open(path) as image:
        image.convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    return path


def _draw_panel(axes: Axes, area: Area[Any, Any], rows: Sequence[Row], panel: Panel, factors: Sequence[str]) -> None:
    column = time_column(rows)
    known = [row for row in rows if row.get(panel.skill) is not None]
    line = frontier(rows, panel.skill)
    low, high = line[0][panel.skill], line[-1][panel.skill]
    skills = [row[panel.skill] for row in known]
    span = max(high - low, _LOWEST * min(max(skills) - min(skills), 0.2)) or 0.05
    floor = low - _LOWEST * span
    axes.step([r[column] for r in line], [r[panel.skill] for r in line], where="post", color="black", linewidth=1)
    for row in known:
        colour = f"C{factors.index(row['factor']) % 10}"
        marker = "*" if row["factor"] == "shipped" else "os^Dv"[factors.index(row["factor"]) // 10 % 5]
        y = max(row[panel.skill], floor)
        axes.plot(
            row[column], y, linestyle="", marker="v" if row[panel.skill] < floor else marker, color=colour,
            markersize=11 if marker == "*" else 5, label=row["factor"], alpha=1.0 if row in line else 0.55,
            zorder=3 if row in line else 2,
        )  # fmt: skip
        if (lower := row.get(f"{panel.skill}_low")) is not None and row in line:
            axes.plot([row[column]] * 2, [max(lower, floor), row[f"{panel.skill}_high"]], color=colour, linewidth=0.6)
    axes.set_xscale("log")
    axes.set_ylim(floor - 0.1 * span, high + 0.12 * span)
    for one in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        one(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
    axes.grid(visible=True, which="both", alpha=0.2)
    kind = "wall time, median" if column == "ms_p50" else "processor time, median (loaded machine)"
    axes.set_xlabel(f"{kind} [ms]")
    axes.set_ylabel(area.skills[panel.skill])
    axes.set_title(panel.title, fontsize=10)
    _name(axes, line, panel.skill, column)


def _name(axes: Axes, line: Sequence[Row], skill: str, column: str) -> None:
    """Write the names of the frontier right of the axes, one below the other, each joined to its point by a line.

    The skills of a frontier ascend, so that neither names nor lines cross.
    """
    low, high = axes.get_ylim()
    wanted = [(row[skill] - low) / (high - low) for row in line]
    places = spread(wanted, _LINE)
    for row, place in zip(line, places, strict=True):
        axes.annotate(
            f"{row['variant']}  {row[column]:.3g} ms", (row[column], row[skill]), (1.04, place),
            textcoords="axes fraction", va="center", fontsize=7.5, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "linewidth": 0.4, "color": "grey", "shrinkA": 0, "shrinkB": 3, "relpos": (0.0, 0.5)},
        )  # fmt: skip


def spread(wanted: Sequence[float], gap: float) -> list[float]:
    """Places near the wanted ascending ones in [0, 1] that are at least a gap apart, if they fit."""
    from sklearn.isotonic import isotonic_regression

    count = len(wanted)
    offsets = min(gap, 1.0 / max(count - 1, 1)) * np.arange(count)
    nearest = isotonic_regression(np.asarray(wanted, np.float64) - offsets)  # with least squares
    return [float(place) for place in np.clip(nearest, 0.0, 1.0 - offsets[-1]) + offsets]
