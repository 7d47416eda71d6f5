# SPDX-License-Identifier: Apache-2.0
"""Skill over how much was learned from, a panel for each ground and modality."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw", "draw_curve"]

_LEAST: Final = -0.6
_SIDESTEP: Final = 0.04  # of a size, so that intervals do not hide each other


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`curve.png`: grounds below each other, modalities side by side."""
    grounds = list(dict.fromkeys(row["ground"] for row in rows))
    who = list(dict.fromkeys(row["predictor"] for row in rows))
    figure = new_figure(14.0, 0.6 + 3.0 * len(grounds))
    grid = figure.subplots(len(grounds), len(MODALITIES), squeeze=False, sharey="row")
    for line, ground in zip(grid, grounds, strict=True):
        for axes, modality in zip(line, MODALITIES, strict=True):
            key = (ground, modality, "all")
            mine = [row for row in rows if (row["ground"], row["modality"], row["object"]) == key]
            draw_curve(axes, mine, who)
            axes.set_title(f"{ground}: {modality}", fontsize=9)
            axes.set_xlabel(_unit(mine[0]))
        line[0].set_ylabel("skill, 95 % interval")
    grid[0, -1].legend(fontsize=8)
    return [save(figure, folder / "curve.png")]


def _unit(row: Mapping[str, Any]) -> str:
    """`new objects, 4 objects` is told over objects."""
    told: str = row["table"].removeprefix(f"{row['ground']}, {row['size']} ")
    return f"{told} to learn from"


def draw_curve(axes: Axes, rows: Rows, who: Sequence[str]) -> None:
    """A line for each predictor over the size, which is drawn on a logarithmic scale."""
    sizes = sorted({row["size"] for row in rows})
    for number, name in enumerate(who):
        mine = sorted((row for row in rows if row["predictor"] == name), key=lambda row: row["size"])
        places = [row["size"] * (1.0 + _SIDESTEP * number) for row in mine]
        axes.plot(places, [row["skill"] for row in mine], marker="o", markersize=4, color=f"C{number}", label=name)
        for place, row in zip(places, mine, strict=True):
            if row["skill_low"] is not None:
                axes.plot([place, place], [row["skill_low"], row["skill_high"]], color=f"C{number}", linewidth=1)
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_ylim(max(_LEAST, axes.get_ylim()[0]), None)
    axes.grid(visible=True, alpha=0.3)
