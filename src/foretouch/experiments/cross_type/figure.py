# SPDX-License-Identifier: Apache-2.0
"""Errors within a type of object and across types, with P1's published ones beside them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from foretouch.experiments.shared.skill_figure import draw as draw_skill_panels
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw", "draw_errors"]

_PUBLISHED: Final = "P1 (published)"
_SIDESTEP: Final = 0.1  # so that markers do not hide each other


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`rmse.png`, the tables that P1 has too, and `skill.png`, all of them."""
    together = [row for row in rows if row["object"] == "all"]
    tables = list(dict.fromkeys(row["table"] for row in together if row["predictor"] == _PUBLISHED))
    figure = new_figure(12.0, 3.4)
    panels = figure.subplots(1, len(MODALITIES), sharey=False)
    for axes, modality in zip(panels, MODALITIES, strict=True):
        mine = [row for row in together if row["modality"] == modality and row["table"] in tables]
        draw_errors(axes, mine, tables)
        axes.set_title(modality)
    panels[0].set_ylabel("RMSE [counts]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return [save(figure, folder / "rmse.png"), *draw_skill_panels(rows, folder)]


def draw_errors(axes: Axes, rows: Rows, tables: Sequence[str]) -> None:
    """RMSE of each predictor over the tables; what was published in black."""
    names = list(dict.fromkeys(row["predictor"] for row in rows))
    ours = [name for name in names if name != _PUBLISHED]
    for number, name in enumerate(names):
        mine = [row for row in rows if row["predictor"] == name]
        colour, marker = ("black", "*") if name == _PUBLISHED else (f"C{number}", "o")
        step = 0.0 if name == _PUBLISHED else _SIDESTEP * (ours.index(name) - (len(ours) - 1) / 2)
        places = [tables.index(row["table"]) + step for row in mine]
        axes.plot(places, [row["rmse"] for row in mine], marker, color=colour, label=name, markersize=6)
    axes.set_xticks(range(len(tables)), [name.replace(" ", "\n", 1) for name in tables], fontsize=8)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.15)
    axes.grid(visible=True, axis="y", alpha=0.3)
