# SPDX-License-Identifier: Apache-2.0
"""Skill on an object that was not trained on, over the number of its touches; and object by object."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw", "draw_course"]

_LEAST: Final = -1.0
"""What lies below is told by an arrow at this edge."""

_SHIPPED: Final = "contact"
_SIDESTEP: Final = 0.12  # so that intervals do not hide each other


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`touches.png`: modalities side by side, all objects together above; each of them below, by the shipped model if it is there."""
    who = list(dict.fromkeys(row["predictor"] for row in rows))
    chosen = _SHIPPED if _SHIPPED in who else who[-1]
    objects = sorted({row["object"] for row in rows} - {"all"})
    figure = new_figure(14.0, 7.5)
    above, below = figure.subplots(2, len(MODALITIES), sharex=True, sharey="row")
    for axes, modality in zip(above, MODALITIES, strict=True):
        mine = [row for row in rows if row["modality"] == modality and row["object"] == "all"]
        draw_course(axes, mine, "predictor", who)
        axes.set_title(modality)
    for axes, modality in zip(below, MODALITIES, strict=True):
        mine = [row for row in rows if row["modality"] == modality and row["predictor"] == chosen]
        draw_course(axes, mine, "object", objects)
        axes.set_xlabel("touches of the new object")
    above[0].set_ylabel("skill, all objects, 95 % interval")
    below[0].set_ylabel(f"skill, {chosen}, each object")
    figure.legend(*above[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    figure.legend(*below[0].get_legend_handles_labels(), loc="outside right lower", fontsize=8)
    return [save(figure, folder / "touches.png")]


def draw_course(axes: Axes, rows: Rows, column: str, names: Sequence[str], least: float = _LEAST) -> None:
    """A line for each name in a column, with intervals where there are some; an arrow for what lies below `least`."""
    counts = sorted({row["touches"] for row in rows})
    for number, name in enumerate(names):
        mine = sorted((row for row in rows if row[column] == name), key=lambda row: row["touches"])
        step = _SIDESTEP * (number - (len(names) - 1) / 2) if column == "predictor" else 0.0
        places = [counts.index(row["touches"]) + step for row in mine]
        axes.plot(places, [row["skill"] for row in mine], marker="o", markersize=4, color=f"C{number}", label=name)
        for place, row in zip(places, mine, strict=True):
            if row["skill"] < least:
                axes.plot(place, least, marker="v", color=f"C{number}", clip_on=False)
            if row["skill_low"] is not None:
                axes.plot([place, place], [row["skill_low"], row["skill_high"]], color=f"C{number}", linewidth=1)
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_ylim(least, 1.0)
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, alpha=0.3)
