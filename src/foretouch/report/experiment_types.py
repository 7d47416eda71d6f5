# SPDX-License-Identifier: Apache-2.0
"""Errors within a type of object and across types, with P1's published ones beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from foretouch.report.experiment_skills import draw as draw_skill_panels

__all__ = ["draw", "draw_errors"]

Rows = Sequence[Mapping[str, Any]]

_PUBLISHED: Final = "P1 (published)"
_MODALITIES: Final = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`rmse.png`, the tables that P1 has too, and `skill.png`, all of them."""
    together = [row for row in rows if row["object"] == "all"]
    tables = list(dict.fromkeys(row["table"] for row in together if row["predictor"] == _PUBLISHED))
    figure = Figure(figsize=(12.0, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(_MODALITIES), sharey=False)
    for axes, modality in zip(panels, _MODALITIES, strict=True):
        mine = [row for row in together if row["modality"] == modality and row["table"] in tables]
        draw_errors(axes, mine, tables)
        axes.set_title(modality)
    panels[0].set_ylabel("RMSE [counts]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    path = folder / "rmse.png"
    figure.savefig(path, dpi=120)
    return [path, *draw_skill_panels(rows, folder)]


def draw_errors(axes: Axes, rows: Rows, tables: Sequence[str]) -> None:
    """RMSE of each predictor over the tables; what was published in black."""
    for number, name in enumerate(dict.fromkeys(row["predictor"] for row in rows)):
        mine = [row for row in rows if row["predictor"] == name]
        colour, marker = ("black", "*") if name == _PUBLISHED else (f"C{number}", "o")
        places = [tables.index(row["table"]) for row in mine]
        axes.plot(places, [row["rmse"] for row in mine], marker, color=colour, label=name, markersize=7, alpha=0.8)
    axes.set_xticks(range(len(tables)), tables, rotation=20, fontsize=8)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.15)
    axes.grid(visible=True, axis="y", alpha=0.3)
