# SPDX-License-Identifier: Apache-2.0
"""What figures share: the rows of experiments, how a figure is begun and written, and what is told at its edge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["Rows", "new_figure", "save", "tell_below"]

Rows = Sequence[Mapping[str, Any]]
"""Of a `results.csv`, as `read_results` gives them."""

_DPI = 120


def new_figure(width: float, height: float) -> Figure:
    """A figure that needs no display.

    Args:
        width: [inch].
        height: [inch].
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG; gives the path."""
    figure.savefig(path, dpi=_DPI)
    return path


def tell_below(axes: Axes, least: float, place: float, text: str, colour: str) -> None:
    """An arrow at the left edge, `least`, with the number that lies beyond it."""
    axes.plot(least, place, marker="<", color=colour, clip_on=False)
    axes.annotate(text, (least, place), (6, 0), textcoords="offset points", va="center", fontsize=8)
