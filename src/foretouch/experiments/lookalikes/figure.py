# SPDX-License-Identifier: Apache-2.0
"""Skill on objects that look alike over the number of touches, and what it would be if one were told which it is."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from foretouch.experiments.unseen_object.figure import draw_course
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile.modalities import MODALITIES

__all__ = ["draw"]

_LEAST: Final = -0.2


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`lookalikes.png`: modalities side by side, all encounters together; dashed where the object is told."""
    together = [row for row in rows if row["kind"] == "all"]
    who = list(dict.fromkeys(row["predictor"] for row in together))
    figure = new_figure(13.0, 3.8)
    panels = figure.subplots(1, len(MODALITIES), sharey=True, sharex=True)
    for axes, modality in zip(panels, MODALITIES, strict=True):
        mine = [row for row in together if row["modality"] == modality]
        draw_course(axes, [row for row in mine if row["touches"] is not None], "predictor", who, _LEAST)
        for row in mine:
            if row["touches"] is None:
                axes.axhline(row["skill"], color=f"C{who.index(row['predictor'])}", linestyle="--", linewidth=0.8)
        axes.set_title(modality)
        axes.set_xlabel("touches of the object at hand")
    panels[0].set_ylabel("skill, 95 % interval; dashed: told which")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return [save(figure, folder / "lookalikes.png")]
