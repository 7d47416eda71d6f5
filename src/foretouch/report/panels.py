# SPDX-License-Identifier: Apache-2.0
"""What the figures of experiments share: their rows, and how a figure is begun and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["Rows", "new_figure", "save"]

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
