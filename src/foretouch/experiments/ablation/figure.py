# SPDX-License-Identifier: Apache-2.0
"""What is gained or lost against the whole model, or against nothing to lean on, with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from foretouch.report.panels import Rows, new_figure, save, tell_below
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw", "draw_differences"]

_REFERENCES: Final = ("full", "nothing")
_LEAST: Final = -0.3
"""What lies below is drawn at this edge, as an arrow with its number."""


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`ablation.png`: tables below each other, modalities side by side."""
    tables = list(dict.fromkeys(row["table"] for row in rows))
    sizes = [len({row["predictor"] for row in rows if row["table"] == table}) - 1 for table in tables]
    figure = new_figure(15.0, 0.6 + sum(0.9 + 0.22 * size for size in sizes))
    ratios = [3.0 + size for size in sizes]
    grid = figure.subplots(
        len(tables), len(MODALITIES), squeeze=False, height_ratios=ratios, sharex="row", sharey="row"
    )
    for line, table in zip(grid, tables, strict=True):
        mine = [row for row in rows if row["table"] == table]
        reference = next(name for name in _REFERENCES if any(row["predictor"] == name for row in mine))
        who = list(dict.fromkeys(row["predictor"] for row in mine if row["predictor"] != reference))
        for axes, modality in zip(line, MODALITIES, strict=True):
            shown = [row for row in mine if row["modality"] == modality and row["predictor"] != reference]
            draw_differences(axes, shown, who, f"vs_{reference}")
            axes.set_title(f"{table}: {modality}", fontsize=8)
        line[0].set_xlabel(f"skill less that of `{reference}`", fontsize=8)
        line[0].set_ylim(len(who) - 0.5, -0.5)
    figure.suptitle("green: better, red: worse, grey: a tie; 95 % interval by bootstrap over objects", fontsize=9)
    return [save(figure, folder / "ablation.png")]


def draw_differences(axes: Axes, rows: Rows, who: Sequence[str], column: str) -> None:
    """Difference and interval of each variant, one below the other; colours tell what is shown."""
    colours = {"better": "C2", "worse": "C3"}
    for row in rows:
        place, value = who.index(row["predictor"]), row[column]
        colour = colours.get(row[f"{column}_verdict"], "grey")
        if value < _LEAST:
            tell_below(axes, _LEAST, place, f"{value:.2f}", colour)
            continue
        axes.plot(value, place, marker="o", color=colour, markersize=4)
        if row[f"{column}_low"] is not None:
            axes.plot([max(row[f"{column}_low"], _LEAST), row[f"{column}_high"]], [place, place], color=colour)
    axes.axvline(0.0, color="black", linewidth=0.6)
    axes.set_yticks(range(len(who)), who, fontsize=8)
    axes.tick_params(axis="x", labelsize=7)
    axes.grid(visible=True, axis="x", alpha=0.3)
