# SPDX-License-Identifier: Apache-2.0
"""Skill of each predictor with its interval: a panel for each table and modality."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from foretouch.report.panels import Rows, new_figure, save, tell_below
from foretouch.tactile.modalities import MODALITIES

__all__ = ["LEAST_SKILL", "draw", "draw_skills"]

LEAST_SKILL: Final = -1.5
"""What lies below is drawn at this edge, as an arrow with its number."""


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`skill.png`: tables below each other, modalities side by side."""
    # The training mean has a skill of 0 by definition: it is the line.
    shown = [r for r in rows if r["object"] == "all" and r["skill"] is not None and r["predictor"] != "training_mean"]
    tables = list(dict.fromkeys(row["table"] for row in shown))
    who = list(dict.fromkeys(row["predictor"] for row in shown))
    height = 1.0 + len(tables) * (0.7 + 0.3 * len(who))
    figure = new_figure(12.0, height)
    grid = figure.subplots(len(tables), len(MODALITIES), squeeze=False, sharey=True, sharex=True)
    for line, table in zip(grid, tables, strict=True):
        for axes, modality in zip(line, MODALITIES, strict=True):
            draw_skills(axes, [r for r in shown if r["table"] == table and r["modality"] == modality], who)
            axes.set_title(f"{table}: {modality}", fontsize=10)
    grid[0, 0].set_ylim(len(who) - 0.5, -0.5)
    for axes in grid[-1]:
        axes.set_xlabel("skill (0: training mean)")
    return [save(figure, folder / "skill.png")]


def draw_skills(axes: Axes, rows: Rows, who: Sequence[str]) -> None:
    """Skill and interval of each predictor, one above the other."""
    for row in rows:
        place = who.index(row["predictor"])
        colour = f"C{place % 10}"
        if row["skill"] < LEAST_SKILL:
            tell_below(axes, LEAST_SKILL, place, f"{row['skill']:.1f}", colour)
            continue
        axes.plot(row["skill"], place, marker="o", color=colour)
        if row["skill_low"] is not None:
            axes.plot([max(row["skill_low"], LEAST_SKILL), row["skill_high"]], [place, place], color=colour)
    axes.axvline(0.0, color="grey", linewidth=0.8)
    axes.set_yticks(range(len(who)), who)
    axes.grid(visible=True, axis="x", alpha=0.3)
