# SPDX-License-Identifier: Apache-2.0
"""Skill on an object that was not trained on, over the number of its touches; and object by object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["draw", "draw_course"]

Rows = Sequence[Mapping[str, Any]]

_MODALITIES: Final = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")
_LEAST: Final = -1.0
_SIDESTEP: Final = 0.12  # so that intervals do not hide each other


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`touches.png`: modalities side by side, all objects together above, each object's last predictor below."""
    who = list(dict.fromkeys(row["predictor"] for row in rows))
    objects = sorted({row["object"] for row in rows} - {"all"})
    figure = Figure(figsize=(14.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, len(_MODALITIES), sharex=True, sharey="row")
    for axes, modality in zip(above, _MODALITIES, strict=True):
        mine = [row for row in rows if row["modality"] == modality and row["object"] == "all"]
        draw_course(axes, mine, "predictor", who)
        axes.set_title(modality)
    for axes, modality in zip(below, _MODALITIES, strict=True):
        mine = [row for row in rows if row["modality"] == modality and row["predictor"] == who[-1]]
        draw_course(axes, mine, "object", objects)
        axes.set_xlabel("touches of the new object")
    above[0].set_ylabel("skill, all objects, 95 % interval")
    below[0].set_ylabel(f"skill, {who[-1]}, each object")
    above[-1].legend(fontsize=8)
    below[-1].legend(fontsize=7, ncols=2)
    path = folder / "touches.png"
    figure.savefig(path, dpi=120)
    return [path]


def draw_course(axes: Axes, rows: Rows, column: str, names: Sequence[str]) -> None:
    """A line for each name in a column, with intervals where there are some; cut off below a skill of -1."""
    counts = sorted({row["touches"] for row in rows})
    for number, name in enumerate(names):
        mine = sorted((row for row in rows if row[column] == name), key=lambda row: row["touches"])
        step = _SIDESTEP * (number - (len(names) - 1) / 2) if column == "predictor" else 0.0
        places = [counts.index(row["touches"]) + step for row in mine]
        axes.plot(places, [row["skill"] for row in mine], marker="o", markersize=4, color=f"C{number}", label=name)
        for place, row in zip(places, mine, strict=True):
            if row["skill_low"] is not None:
                axes.plot([place, place], [row["skill_low"], row["skill_high"]], color=f"C{number}", linewidth=1)
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_ylim(_LEAST, 1.0)
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, alpha=0.3)
