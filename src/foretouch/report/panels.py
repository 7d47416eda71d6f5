# SPDX-License-Identifier: Apache-2.0
"""What figures share: their style, creation without a display, saving, points of clouds; matplotlib is imported when a figure is drawn.

A page of the documents, and of GitHub, shows a picture 7.7 inches wide: a figure of `PAGE_INCH` keeps the size of its text.
Figures bring their white background along, and are read in the dark, too.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from foretouch.base.files import read_bytes, replace_files
from foretouch.errors import FileError
from foretouch.types import Cloud, Float64

if TYPE_CHECKING:
    import matplotlib.axes
    from matplotlib.figure import Figure


Axes: TypeAlias = "matplotlib.axes.Axes"


PAGE_INCH: Final = 7.7
TEXT_PT, SMALL_PT = 8.5, 7.5
"""Sizes of text; nothing is smaller than 7 points where it is shown."""

FINGER_COLOURS: Final = ("#d1495b", "#00798c", "#6a4c93", "#b07d2b", "#4a7c3a")
"""Of the fingers at g1 and g2, and of others that are recorded."""

OBJECT_COLOURS: Final = ("#ff8000", "#00a6d6", "#e6007e", "#7ab800", "#8f4fd1", "#d9b300", "#00a88f", "#d1495b")
"""Of objects by their order; each has its id beside it for who sees colours in another way."""

INK, FAINT, SKIN, TABLE = "#202020", "#a9b1ba", "#fbf6f1", "#8a6d3b"

_MAX_POINTS: Final = 5000  # more make a scatter plot slower, not denser

Rows = Sequence[Mapping[str, Any]]
"""Rows of a `results.csv`."""


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a width and a height [inch]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finger_colour(finger: int) -> str:
    """Return the colour of a finger by its index."""
    return FINGER_COLOURS[finger % len(FINGER_COLOURS)]


def without_formulas(figure: Figure) -> Figure:
    """Show `$` in texts of a figure, such as the name of an object, as it is: Matplotlib takes two for a formula."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if isinstance(text, Text) and "$" in text.get_text() and "mathdefault" not in text.get_text():
            text.set_parse_math(False)
    return figure


def save(figure: Figure, path: Path, dpi: int = 120) -> Path:
    """Write a figure in the format of its suffix, usually PNG, and give its path; its folder is created.

    A `FileError` if the format is unknown, or the file cannot be written.
    """
    content = io.BytesIO()
    try:
        without_formulas(figure).savefig(content, dpi=dpi, format=path.suffix[1:])
    except ValueError as err:
        raise FileError(path, f"cannot be written: {err}") from err
    replace_files({path: content.getvalue()})
    return path


def save_small(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG with a palette of 128 colours, less than half as large."""
    from PIL import Image
    from PIL.PngImagePlugin import PngImageFile

    content = io.BytesIO()
    with PngImageFile(io.BytesIO(read_bytes(save(figure, path)))) as image:
        image.convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(content, "PNG", optimize=True)
    replace_files({path: content.getvalue()})
    return path


def some_points(cloud: Cloud) -> Float64:
    """Return at most some thousand finite points of a cloud: (N, 3) float64 [m]."""
    points = cloud.finite
    return points[:: max(1, len(points) // _MAX_POINTS)].astype(np.float64)
