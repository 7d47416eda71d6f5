# SPDX-License-Identifier: Apache-2.0
"""Many grasps on one page: the cloud with its contacts, and what both fingertips read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from foretouch.report.panels import new_figure
from foretouch.report.touch_figure import FINGER_COLOURS, draw_electrodes, draw_front
from foretouch.types import GraspSample

__all__ = ["save_contact_sheet"]

_COLUMNS = 2  # samples side by side
_ROW_INCHES = 2.9
_FINGERS = (("thumb", "TH"), ("middle", "MF"))


def save_contact_sheet(path: str | Path, samples: Sequence[GraspSample], title: str = "") -> Path:
    """Write one PNG of labelled samples.

    Args:
        path: Where to; its folder is made.
        samples: What is drawn, in order. An unlabelled one is drawn without its fingers.
        title: Above all.

    Returns:
        The path.
    """
    rows = max(1, -(-len(samples) // _COLUMNS))
    figure = new_figure(7.2 * _COLUMNS, _ROW_INCHES * rows + 0.4)
    figure.suptitle(title)
    grid = figure.subplots(rows, 3 * _COLUMNS, squeeze=False, width_ratios=[1.1, 0.8, 0.8] * _COLUMNS)
    for axes in grid.flat:
        axes.set_axis_off()
    for k, sample in enumerate(samples):
        row, column = divmod(k, _COLUMNS)
        _draw(list(grid[row, 3 * column : 3 * column + 3]), sample)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    return path


def _draw(axes: Sequence[Axes], sample: GraspSample) -> None:
    seen, *fingers = axes
    seen.set_axis_on()
    draw_front(seen, sample.cloud, sample.grasp)
    seen.set_title(f"{sample.id}, {1e3 * sample.grasp.width_m:.0f} mm", fontsize=9)
    if sample.touch is None:
        return
    for place, (finger, name) in zip(fingers, _FINGERS, strict=True):
        suffix, colour = name.lower(), FINGER_COLOURS[name]
        place.set_axis_on()
        rest = None if sample.tare is None else getattr(sample.tare, f"e_{suffix}")
        draw_electrodes(place, getattr(sample.touch, f"e_{suffix}"), rest, colour=colour)
        force = sample.extra.get(f"force_{suffix}_n")
        told = "" if force is None else f", {force:.1f} N"
        place.set_title(f"{finger}, PDC {getattr(sample.touch, f'pdc_{suffix}'):.0f}{told}", fontsize=9, color=colour)
