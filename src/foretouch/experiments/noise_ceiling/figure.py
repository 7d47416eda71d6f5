# SPDX-License-Identifier: Apache-2.0
"""What can be told from cloud and grasp, what each hidden cause takes away, and how much of it predictors tell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw", "draw_ceiling"]


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`ceiling.png`: modalities side by side."""
    names = list(dict.fromkeys(row["name"] for row in rows))
    figure = new_figure(13.0, 1.2 + 0.35 * len(names))
    panels = figure.subplots(1, len(MODALITIES), sharey=True, sharex=True)
    for axes, modality in zip(panels, MODALITIES, strict=True):
        draw_ceiling(axes, [row for row in rows if row["modality"] == modality], names)
        axes.set_title(modality)
        axes.set_xlabel("skill (0: training mean)")
    panels[0].invert_yaxis()
    return [save(figure, folder / "ceiling.png")]


def draw_ceiling(axes: Axes, rows: Rows, names: Sequence[str]) -> None:
    """Skill and interval of each row, one below the other; the share of the ceiling beside predictors."""
    for row in rows:
        place = names.index(row["name"])
        colour = "C0" if row["share"] is None else "C1"
        axes.barh(place, max(row["skill"], 0.0), color=colour, alpha=0.5)
        axes.plot([row["skill_low"], row["skill_high"]], [place, place], color=colour)
        if row["share"] is not None:
            axes.annotate(f"{100.0 * row['share']:.0f} %", (1.0, place), ha="right", va="center", fontsize=8)
    axes.set_xlim(0.0, 1.02)
    axes.set_yticks(range(len(names)), names)
    axes.grid(visible=True, axis="x", alpha=0.3)
