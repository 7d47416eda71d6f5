# SPDX-License-Identifier: Apache-2.0
"""Draw the readings of grasps, also of recordings without a camera: taxels over time, and both pads at the strongest reading."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from foretouch.report.finger_figure import FingerScale
from foretouch.report.panels import PAGE_INCH, SMALL_PT, TEXT_PT, new_figure, save
from foretouch.tactile.dead_taxels import usable
from foretouch.tactile.description import Sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import REST, SECOND_NS, Float64, Sample, Touch, TouchSeries

_OUTCOMES: Final = {"success": "#1a7f37", "failure": "#c9252d", "unknown": "#404040"}
_ROW_INCH: Final = 2.0  # height of a grasp


def save_series_sheet(path: str | Path, records: Sequence[Sample], title: str, sensor: Sensor) -> Path:
    """Write one PNG with a row for each grasp that was read: what became of it, its taxels over time, and its pads.

    Of a grasp of several readings, the pads show the reading that moved the taxels most. Dead taxels are left white over time, and
    are hollow on the pads.

    Args:
        path: File to write.
        records: Samples; those without a reading are left out.
        title: Line above the figure.
        sensor: The sensor that was read.
    """
    view = TaxelView(sensor)
    grasps = [
        (sample, series, _rest(sample, series, view)) for sample in records if (series := sample.readings) is not None
    ]
    levels = [_levels(series, rest, view) for _, series, rest in grasps]
    strongest = [int(np.nanargmax(np.nanmax(np.abs(level), axis=(0, 2)))) for level in levels]
    tared, fingers = all(view.has_rest(rest) for _, _, rest in grasps), len(view.fingers)
    pads = [
        [view.levels(series.counts[k].astype(np.float64), rest if tared else None, finger) for finger in range(fingers)]
        for (_, series, rest), k in zip(grasps, strongest, strict=True)
    ]
    shown = [pad[sensor.valid[finger]] for row in pads for finger, pad in enumerate(row)]
    scale = FingerScale(view, shown, tared=tared)
    figure = new_figure(PAGE_INCH, _ROW_INCH * len(grasps) + 1.0)
    figure.suptitle(title, fontsize=TEXT_PT)
    widths = [2.0] * fingers + [1.0] * fingers
    grid = figure.subplots(len(grasps), 2 * fingers, squeeze=False, width_ratios=widths)
    for row, (sample, series, _), strongest_of, k, pad in zip(grid, grasps, levels, strongest, pads, strict=True):
        for finger, name in enumerate(view.fingers):
            _draw_over_time(row[finger], sample, series, strongest_of[finger], k, scale)
            row[finger].set_ylabel(f"{name}, taxel", fontsize=SMALL_PT)
            scale.draw(row[fingers + finger], finger, pad[finger])
            row[fingers + finger].set_title(name, fontsize=SMALL_PT)
        row[0].set_title(
            f"{sample.id}: {sample.outcome}", color=_OUTCOMES[sample.outcome], fontsize=TEXT_PT, loc="left"
        )
    scale.add_bar(figure, list(grid.flat), shrink=0.5, aspect=50)
    return save(figure, Path(path), dpi=100)


def _rest(sample: Sample, series: TouchSeries, view: TaxelView) -> Touch | None:
    """Return the tare, else the median of the readings at rest; None without either."""
    at_rest = series.counts[series.phases == REST]
    if sample.tare is None and len(at_rest):
        return Touch(np.median(at_rest, axis=0).astype(np.float64), view.sensor.channels)
    return sample.tare


def _levels(series: TouchSeries, rest: Touch | None, view: TaxelView) -> Float64:
    """Return (F, T, N) levels of the taxels, NaN where they cannot be used."""
    values = usable(series.counts.astype(np.float64), view.sensor.channels, view.sensor.valid_values)
    return np.array([view.levels(values, rest, finger) for finger in range(len(view.fingers))])


def _draw_over_time(
    axes: Axes, sample: Sample, series: TouchSeries, levels: Float64, strongest: int, scale: FingerScale
) -> None:
    """Draw (T, N) levels by time from the first contact, or from the first reading, which the strongest reading divides."""
    zero = sample.contact_ns or series.stamps_ns[0]
    seconds = (series.stamps_ns - zero) / SECOND_NS
    if len(seconds) == 1:
        seconds, levels = seconds + np.array([0.0, 1.0]), np.repeat(levels, 2, axis=0)
        axes.set_xticks([])
    axes.pcolormesh(
        seconds, np.arange(levels.shape[1]), np.ma.masked_invalid(levels.T), shading="nearest", **scale.colours
    )
    axes.axvline(seconds[strongest], color="black", linewidth=0.7, linestyle=":")
    axes.set_xlabel("time from contact [s]" if sample.contact_ns else "time [s]", fontsize=SMALL_PT)
    axes.tick_params(labelsize=SMALL_PT)
