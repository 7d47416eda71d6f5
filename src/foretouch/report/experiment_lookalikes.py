# SPDX-License-Identifier: Apache-2.0
"""Skill on objects that look alike over the number of touches, and what it would be if one were told which it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from foretouch.report.experiment_touches import draw_course

__all__ = ["draw"]

_MODALITIES: Final = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")


def draw(rows: Sequence[Mapping[str, Any]], folder: Path) -> list[Path]:
    """`lookalikes.png`: modalities side by side, all encounters together; dashed where the object is told."""
    together = [row for row in rows if row["kind"] == "all"]
    who = list(dict.fromkeys(row["predictor"] for row in together))
    figure = Figure(figsize=(13.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(_MODALITIES), sharey=True, sharex=True)
    for axes, modality in zip(panels, _MODALITIES, strict=True):
        mine = [row for row in together if row["modality"] == modality]
        draw_course(axes, [row for row in mine if row["touches"] is not None], "predictor", who)
        for row in mine:
            if row["touches"] is None:
                axes.axhline(row["skill"], color=f"C{who.index(row['predictor'])}", linestyle="--", linewidth=0.8)
        axes.set_ylim(-0.2, 1.0)
        axes.set_title(modality)
        axes.set_xlabel("touches of the object at hand")
    panels[0].set_ylabel("skill, 95 % interval; dashed: told which")
    panels[-1].legend(fontsize=8)
    path = folder / "lookalikes.png"
    figure.savefig(path, dpi=120)
    return [path]
