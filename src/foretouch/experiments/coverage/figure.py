# SPDX-License-Identifier: Apache-2.0
"""Coverage of 90 % intervals, a dot for each object, and how wide the intervals are beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw", "draw_coverage", "draw_widths"]

_AIM: Final = 0.9
_SOUGHT: Final = (0.85, 0.95)


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`coverage.png`: a line of panels for each ground, with a tare and without: modalities, then their widths."""
    grounds = list(dict.fromkeys((row["ground"], row["tare"]) for row in rows))
    figure = new_figure(16.0, 0.6 + 2.5 * len(grounds))
    grid = figure.subplots(len(grounds), len(MODALITIES) + 1, squeeze=False)
    for line, (ground, tare) in zip(grid, grounds, strict=True):
        mine = [row for row in rows if (row["ground"], row["tare"]) == (ground, tare)]
        for axes, modality in zip(line, MODALITIES, strict=False):
            draw_coverage(axes, [row for row in mine if row["modality"] == modality])
            axes.set_title(modality, fontsize=10)
        line[0].set_ylabel(f"{ground}{', tare' if tare else ''}\ncoverage")
        draw_widths(line[-1], [row for row in mine if row["object"] == "all"])
        line[-1].set_title("width / that of the mean of labels", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("touches")
    grid[0, -1].legend(fontsize=7, loc="lower left")
    return [save(figure, folder / "coverage.png")]


def draw_coverage(axes: Axes, rows: Rows) -> None:
    """Of one modality over touches: a dot an object, the mean of all with its interval, and where it has to lie."""
    counts = sorted({row["touches"] for row in rows})
    axes.axhspan(*_SOUGHT, color="C2", alpha=0.15)
    axes.axhline(_AIM, color="C2", linewidth=1.0)
    for place, count in enumerate(counts):
        mine = [row for row in rows if row["touches"] == count]
        dots = sorted(row["coverage"] for row in mine if row["object"] != "all")
        spread = [place - 0.3 + 0.4 * k / max(len(dots) - 1, 1) for k in range(len(dots))]
        axes.plot(spread, dots, ".", color="C0", markersize=4, alpha=0.6)
        for row in mine:
            if row["object"] == "all":
                axes.plot(place + 0.25, row["coverage"], "o", color="k", markersize=5)
                if row["low"] is not None:
                    axes.plot([place + 0.25] * 2, [row["low"], row["high"]], color="k")
    axes.set_ylim(min(0.4, *(row["coverage"] for row in rows)) - 0.02, 1.02)
    axes.set_xlim(-0.5, len(counts) - 0.5)
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, axis="y", alpha=0.3)


def draw_widths(axes: Axes, rows: Rows) -> None:
    """Of all objects together, a line for each modality."""
    counts = sorted({row["touches"] for row in rows})
    for number, modality in enumerate(MODALITIES):
        mine = sorted((row for row in rows if row["modality"] == modality), key=lambda row: row["touches"])
        places = [counts.index(row["touches"]) for row in mine]
        axes.plot(places, [row["width"] for row in mine], marker="o", color=f"C{number}", label=modality, markersize=4)
    axes.axhline(1.0, color="grey", linewidth=0.8)
    axes.set_ylim(0.0, max(1.1, *(1.05 * row["width"] for row in rows)))
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, alpha=0.3)
