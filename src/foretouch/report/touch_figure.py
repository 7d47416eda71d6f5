# SPDX-License-Identifier: Apache-2.0
"""Draw grasps: what the camera sees with the contacts, and both fingertips with their taxels.

`save_touch_picture` draws predictions beside what was read, `save_contact_sheet` many labelled samples on one page, and
`save_series_sheet` readings over time, also of recordings without a camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from foretouch.report.camera_figure import area_of, draw_camera
from foretouch.report.finger_figure import FingerScale, finger_levels, title_finger
from foretouch.report.panels import FINGER_COLOURS, PAGE_INCH, SMALL_PT, TEXT_PT, Axes, new_figure, save, some_points
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import DISCARDED, Bool, Cloud, Float64, Grasp, Prediction, Sample, Touch, assumed_table
from foretouch.types.scene import Object

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase
from typing import Final

from foretouch.tactile.dead_taxels import usable
from foretouch.types import REST, SECOND_NS, TouchSeries

_FINGER_INCH = 1.75  # height of a finger, with its title
_SCALE_INCH = 1.05  # height of the scale of colours
_LINE = 105  # characters of a title
_OUTCOMES: Final = {"success": "#1a7f37", "failure": "#c9252d", "unknown": "#404040"}
_ROW_INCH: Final = 2.0  # height of a grasp


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnGrasp:
    """One grasp to draw: its object, its predictions, and what was read where it was executed."""

    prediction: Prediction  # a refused one is drawn without its taxels
    earlier: Prediction | None = None  # of the same grasp, before the first touch of the object; is compared, not drawn
    target: Object | None = None  # the object; None draws neither scene nor contacts
    scene: Cloud | None = None  # the whole cloud, drawn if it is organised; None if there is only the object
    rest: Touch | None = None  # reading without contact; taxels are then coloured by their change from it
    read: Touch | None = None  # reading of the executed grasp
    title: str = ""


class _Column(NamedTuple):
    """The fingers below each other: a prediction, or what was read."""

    what: str
    touch: Touch
    levels: list[Float64]
    halves: list[Float64 | None]
    outside: Bool | None = None  # (D,) values that were read outside of their intervals
    prediction: Prediction | None = None


def save_touch_picture(
    path: str | Path, grasps: Sequence[DrawnGrasp], sensor: Sensor = BIOTAC_SP, *, scenes: bool = True
) -> Path:
    """Write one PNG with a part for each grasp: what the camera sees, taxels predicted and read, and how they agree.

    All touches are of one sensor. Taxels that were read outside of their intervals have a square around them, dead ones are hollow.
    The folder of the file is created.

    Args:
        path: File to write.
        grasps: What is drawn in each part.
        sensor: The sensor of all touches.
        scenes: Whether the images are drawn; else each object is drawn alone, and its fingers beside each other.
    """
    view = TaxelView(sensor)
    scenes = scenes and any(grasp.target is not None for grasp in grasps)
    tared = all(view.has_rest(grasp.rest) for grasp in grasps if grasp.read or grasp.prediction.ok)
    columns = [_columns(grasp, view, tared=tared) for grasp in grasps]
    all_columns = [column for row in columns for column in row]
    levels = [level[sensor.valid[k]] for column in all_columns for k, level in enumerate(column.levels)]
    halves = [half for column in all_columns for half in column.halves if half is not None]
    scale = FingerScale(view, levels, halves, tared=tared)
    lines = [len(view.fingers) if scenes else 1 for _ in grasps]
    heights = [_FINGER_INCH * count + 0.5 for count in lines]
    figure = new_figure(PAGE_INCH, sum(heights) + _SCALE_INCH)
    *parts, below = np.asarray(figure.subfigures(len(grasps) + 1, 1, height_ratios=[*heights, _SCALE_INCH]))
    for part, grasp, row in zip(parts, grasps, columns, strict=True):
        part.suptitle("\n".join(filter(None, (grasp.title, _agreement(grasp, sensor)))), fontsize=TEXT_PT)
        count = max(1, len(row) * (1 if scenes else len(view.fingers)))
        if grasp.target is not None:
            left, part = part.subfigures(1, 2, width_ratios=[1.0 if scenes else 0.7, 0.55 * count])  # noqa: PLW2901
            _draw_seen(left.subplots(), grasp, grasp.target, view, scenes=scenes)
        if row:
            _draw_columns(part, row, scale, across=not scenes)
    if all_columns:
        axes = below.subplots()
        axes.set_axis_off()
        scale.add_bar(below, axes, fraction=1.0, shrink=0.85, aspect=45)
    return save(figure, Path(path), dpi=120)


def _columns(grasp: DrawnGrasp, view: TaxelView, *, tared: bool) -> list[_Column]:
    """Return what is drawn beside each other: predicted, read."""
    rest, prediction = grasp.rest if tared else None, grasp.prediction
    fingers = range(len(view.fingers))
    columns = []
    if prediction.ok:
        drawn = [finger_levels(view, prediction, rest, k) for k in fingers]
        values, halves = [one for one, _ in drawn], [half for _, half in drawn]
        touches = prediction.evidence.touches
        what = f"predicted after\n{touches} touch{'' if touches == 1 else 'es'}" if touches else "predicted"
        columns.append(_Column(what, prediction.value, values, halves, None, prediction))
    if grasp.read is not None:
        levels = [view.levels(grasp.read.values, rest, k) for k in fingers]
        inside = _inside(grasp.prediction, grasp.read)
        columns.append(_Column("read", grasp.read, levels, [None] * len(fingers), None if inside is None else ~inside))
    return columns


def _draw_columns(part: FigureBase, row: Sequence[_Column], scale: FingerScale, *, across: bool) -> None:
    """Draw the prediction and the reading of each finger beside each other, the fingers below each other, or all in one line."""
    view = scale.view
    fingers = len(view.fingers)
    lines, beside = (1, fingers * len(row)) if across else (fingers, len(row))
    grid = part.subplots(lines, beside, squeeze=False).reshape(fingers, len(row))
    for number, column in enumerate(row):
        for k, axes in enumerate(grid[:, number]):
            outside = None if column.outside is None else column.outside[view.columns(k)]
            scale.draw(axes, k, column.levels[k], half=column.halves[k], outside=outside)
            what = column.what if k == 0 or across else ""
            title_finger(axes, scale, k, view.scalars(k, column.touch, column.prediction), what)


def _inside(prediction: Prediction, read: Touch | None) -> Bool | None:
    """Return (D,) which values were read within their intervals; None without both."""
    if read is None or not prediction.calibrated:
        return None
    return (read.values >= prediction.lower.values) & (read.values <= prediction.upper.values)


def _agreement(drawn: DrawnGrasp, sensor: Sensor) -> str:
    """Return a line for each prediction on how it and the reading agree; why there is no prediction; "" if nothing was read."""
    if not drawn.prediction.ok or drawn.read is None:
        return f"not predicted: {drawn.prediction.reason}" if drawn.prediction.reason else ""
    if drawn.earlier is None or not drawn.earlier.ok:
        return _sentence(drawn.prediction, drawn.read, sensor)
    before, after = (_sentence(one, drawn.read, sensor) for one in (drawn.earlier, drawn.prediction))
    return f"before the first touch: {before}\nafter: {after}"


def _sentence(prediction: Prediction, read: Touch, sensor: Sensor) -> str:
    columns = {channel: sensor.taxel_columns[..., k].ravel() for k, channel in enumerate(sensor.taxel_channels)}
    apart = np.abs(prediction.value.values - read.values)
    means = [f"{name.name} {name.text(apart[part].mean())} {name.unit}" for name, part in columns.items()]
    text = f"mean difference: {', '.join(means)}"
    if (inside := _inside(prediction, read)) is None:
        return text
    columns |= {channel: sensor.scalar_columns[:, k] for k, channel in enumerate(sensor.scalar_channels)}
    shares = [f"{inside[part].sum()} of {part.size} {name.name}" for name, part in columns.items()]
    return fill(f"{text}; within their 90 % intervals: {', '.join(shares)}", _LINE)


def save_contact_sheet(path: str | Path, samples: Sequence[Sample], sensor: Sensor = BIOTAC_SP) -> Path:
    """Write one PNG with the contacts and the readings of samples, a row each, as `save_touch_picture` draws them."""
    rows = [
        DrawnGrasp(
            prediction=Prediction.of(sample.grasp, Touch.unknown(sensor.channels), status="refused"),
            target=Object.of(sample.object, sample.cloud, assumed_table(sample.cloud)),
            rest=sample.tare,
            read=sample.touch,
            title=f"{sample.id}, dropped" if DISCARDED in sample.flags else sample.id,
        )
        for sample in samples
    ]
    return save_touch_picture(path, rows, sensor, scenes=False)


def _draw_seen(axes: Axes, grasp: DrawnGrasp, target: Object, view: TaxelView, *, scenes: bool) -> None:
    """Draw what the camera sees around the object, with the grasp; of an object without an image its points."""
    cloud = grasp.scene or target.cloud
    if not scenes or not cloud.organised or target.image_shape is None:
        _draw_front(axes, target.cloud, grasp.prediction.grasp, view.fingers)
        return
    name = f"object {target.id}" if target.id.isdecimal() else target.id
    shown = grasp.prediction.grasp
    draw_camera(axes, cloud, {name: area_of(target, cloud)}, grasp=shown, around=0.7, fingers=view.fingers)
    drawn = f"the grasp, {1e3 * shown.width_m:.0f} mm wide{'' if shown.way is None else ' (pale: the hand)'}"
    axes.set_title(f"what the camera sees, {target.distance_m:.2f} m away,\nand {drawn}", fontsize=TEXT_PT)


def _draw_front(axes: Axes, target: Cloud, grasp: Grasp, fingers: Sequence[str]) -> None:
    """Draw the object from the camera, with both contacts, their fingers and the line between them [m]."""
    points = some_points(target)
    if not len(points):
        axes.set_axis_off()
        return
    axes.scatter(points[:, 0], points[:, 1], s=3, c=points[:, 2], cmap="cividis_r", linewidths=0)
    ends = np.stack([grasp.g1, grasp.g2])
    axes.plot(ends[:, 0], ends[:, 1], color="black", linewidth=1)
    middle, half = (points.min(axis=0) + points.max(axis=0)) / 2.0, 0.9 * float(np.ptp(points[:, :2], axis=0).max())
    upper = int(ends[1, 1] < ends[0, 1])  # y points down
    style: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "fontsize": SMALL_PT, "fontweight": "bold"}
    style["bbox"] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
    for k, (name, colour) in enumerate(zip(fingers, FINGER_COLOURS, strict=False)):
        axes.scatter(ends[k, 0], ends[k, 1], s=50, color=colour, edgecolors="white", zorder=3)
        place, va = (0.97, "top") if k == upper else (0.03, "bottom")
        axes.text(0.5, place, name, va=va, color=colour, **style)  # within the axes, wherever the contact is
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_xlabel("x [m]", fontsize=SMALL_PT)
    axes.set_ylabel("y [m]", fontsize=SMALL_PT)
    axes.tick_params(labelsize=SMALL_PT)
    axes.locator_params(nbins=3)
    axes.set_title(f"grasp, {1e3 * grasp.width_m:.0f} mm wide", fontsize=TEXT_PT)


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
