# SPDX-License-Identifier: Apache-2.0
"""Draw grasps: the scene, the object with its contacts, and both fingertips with their taxels.

`save_touch_picture` draws predictions beside what was read, `save_contact_sheet` many labelled samples on one page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from foretouch.report.panels import FINGER_COLOURS, new_figure, save, some_points
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Bool, Cloud, Float64, Grasp, Prediction, Sample, Touch, assumed_table
from foretouch.types.scene import Object

_ROW_INCH = 2.2  # height of a grasp
_SCALE_INCH = 0.85  # height of the scale of colours
_LINE = 140  # characters of a title
_DOT = 100  # of few taxels [points squared]
_FEW = 32  # taxels that are drawn at full size
_TARGET_COLOUR = "#ff8000"


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnGrasp:
    """One grasp to draw: its object, its prediction, and what was read where it was executed."""

    prediction: Prediction  # a refused one is drawn without its taxels
    target: Object | None = None  # the object; None draws neither scene nor contacts
    scene: Cloud | None = None  # the whole cloud, drawn if it is organised; None if there is only the object
    rest: Touch | None = None  # reading without contact; taxels are then coloured by their change from it
    read: Touch | None = None  # reading of the executed grasp
    title: str = ""


def save_touch_picture(
    path: str | Path, grasps: Sequence[DrawnGrasp], sensor: Sensor = BIOTAC_SP, *, scenes: bool = True
) -> Path:
    """Write one PNG with a row for each grasp: scene (if asked for), contacts, taxels predicted and read, and how they agree.

    All touches are of one sensor. Taxels that were read outside of their intervals have a ring, dead ones are hollow. The folder of
    the file is created.

    Args:
        path: File to write.
        grasps: What is drawn in each row.
        sensor: The sensor of all touches.
        scenes: Whether the scenes are drawn.
    """
    view = TaxelView(sensor)
    tared = all(view.has_rest(grasp.rest) for grasp in grasps if grasp.read or grasp.prediction.ok)
    panels = [_panels(grasp, view, tared=tared) for grasp in grasps]
    most = max(map(len, panels))
    left = [2.6, 1.9][not scenes :] if any(grasp.target for grasp in grasps) else []  # scene and contacts
    figure = new_figure(sum(left) + 1.9 * most, _ROW_INCH * len(grasps) + _SCALE_INCH)
    shown = [levels[sensor.valid[finger]] for row in panels for finger, _, _, levels in row]
    colours = taxel_colours(view, shown, tared=tared)
    drawn = None
    ringed = False
    heights = [_ROW_INCH] * len(grasps) + [_SCALE_INCH]
    *parts, below = np.asarray(figure.subfigures(len(grasps) + 1, 1, hspace=0.01, height_ratios=heights))
    seen = ""  # title of the last scene, which is not repeated
    for part, grasp, row in zip(parts, grasps, panels, strict=True):
        part.suptitle("\n".join(filter(None, (grasp.title, _agreement(grasp, view.sensor)))), fontsize=10)
        axes = part.subplots(1, len(left) + most, squeeze=False, width_ratios=[*left, *[1.9] * most])[0]
        views, fingers, unused = np.split(axes, [len(left), len(left) + len(row)])
        if grasp.target is not None and scenes:
            title = f"what the camera sees\nof the object, {grasp.target.distance_m:.2f} m away"
            _draw_scene(views[0], grasp.scene or grasp.target.cloud, grasp.target, "" if title == seen else title)
            seen = title
        if grasp.target is not None:
            _draw_front(views[-1], grasp.target.cloud, grasp.prediction.grasp, view.fingers)
        for panel in (*unused, *(views if grasp.target is None else ())):
            panel.set_axis_off()
        inside = _inside(grasp)
        for panel, (finger, what, touch, levels) in zip(fingers, row, strict=True):
            outside = None if inside is None or what == "predicted" else ~inside[view.columns(finger)]
            ringed |= outside is not None and bool((outside & sensor.valid[finger]).any())
            drawn = draw_taxels(panel, view, finger, levels, outside, colours)
            scalars = view.scalars(finger, touch, grasp.prediction if what == "predicted" else None)
            title = f"{view.fingers[finger]} {what}\n{scalars}".rstrip()
            panel.set_title(title, color=FINGER_COLOURS[finger], fontsize=10)
    if drawn is not None:
        label = taxel_label(view, tared=tared, ringed=ringed)
        figure.colorbar(drawn, label=label, cax=below.subplots(), orientation="horizontal")
    return save(figure, Path(path), dpi=100)


def _panels(grasp: DrawnGrasp, view: TaxelView, *, tared: bool) -> list[tuple[int, str, Touch, Float64]]:
    """Return finger, `predicted` or `read`, touch and its levels of each panel of taxels; panels of a finger are side by side."""
    touches = {"predicted": grasp.prediction.value if grasp.prediction.ok else None, "read": grasp.read}
    return [
        (finger, what, touch, view.levels(touch.values, grasp.rest if tared else None, finger))
        for finger in range(len(view.fingers))
        for what, touch in touches.items()
        if touch is not None
    ]


def _inside(drawn: DrawnGrasp) -> Bool | None:
    """Return (D,) which values were read within their intervals; None without both."""
    lower, upper = drawn.prediction.lower, drawn.prediction.upper
    if drawn.read is None or not drawn.prediction.calibrated:
        return None
    return (drawn.read.values >= lower.values) & (drawn.read.values <= upper.values)


def _agreement(drawn: DrawnGrasp, sensor: Sensor) -> str:
    """Return a sentence on how prediction and reading agree; why there is no prediction; "" if nothing was read."""
    value, read = drawn.prediction.value, drawn.read
    if not drawn.prediction.ok or read is None:
        return f"not predicted: {drawn.prediction.reason}" if drawn.prediction.reason else ""
    columns = {channel: sensor.taxel_columns[..., k].ravel() for k, channel in enumerate(sensor.taxel_channels)}
    apart = np.abs(value.values - read.values)
    means = [f"{name.name} {name.text(apart[part].mean())} {name.unit}" for name, part in columns.items()]
    text = f"mean difference: {', '.join(means)}"
    if (inside := _inside(drawn)) is None:
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
            title=sample.id,
        )
        for sample in samples
    ]
    return save_touch_picture(path, rows, sensor, scenes=False)


def taxel_colours(view: TaxelView, levels: Sequence[Float64], *, tared: bool) -> dict[str, Any]:
    """Return how matplotlib is to colour the levels of all valid taxels of a page, by one scale."""
    known = np.concatenate([[], *levels])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    colours = "magma_r" if tared else "viridis_r"  # both dark at the high end
    if tared and not view.channel.contact:  # in both directions from rest
        most = max(-low, high)
        low, high = -most, most
        colours = "PuOr"
    return {"vmin": low, "vmax": high, "cmap": colours}


def taxel_label(view: TaxelView, *, tared: bool, ringed: bool = False) -> str:
    """Return what stands at the scale of colours of a page."""
    marks = "; ringed: outside of its 90 % interval" if ringed else ""
    if view.sensor.dead:
        marks += "; hollow: dead"
    return f"{view.label(from_rest=tared)}\nseen from outside, unrolled; up: towards the tip{marks}"


def draw_taxels(
    axes: Axes, view: TaxelView, finger: int, levels: Float64, outside: Bool | None, colours: Mapping[str, Any]
) -> Any:
    """Draw the taxels of one fingertip as `Layout.unrolled`, and return what is coloured.

    Args:
        axes: Where to draw.
        view: The sensor.
        finger: Index of the finger.
        levels: (N,) level of each taxel.
        outside: (N,) taxels that get a ring; None for none.
        colours: Arguments of the scatter plot for their colours.
    """
    sensor, valid = view.sensor, view.sensor.valid[finger]
    across, along = sensor.layout.unrolled.T
    few = sensor.size <= _FEW
    size = _DOT if few else 2.0 * _DOT * _FEW / sensor.size
    edges: dict[str, Any] = {"edgecolors": FINGER_COLOURS[finger % len(FINGER_COLOURS)]} if few else {"linewidths": 0.0}
    drawn = axes.scatter(across[valid], along[valid], s=size, c=levels[valid], **edges, **colours)
    hollow: dict[str, Any] = {"facecolors": "none", "linewidths": 1.3 if few else 0.5}
    if not valid.all():
        axes.scatter(across[~valid], along[~valid], s=size, edgecolors="grey", **hollow)
    if outside is not None:
        ringed = outside & valid
        axes.scatter(across[ringed], along[ringed], s=2.2 * size, edgecolors="black", **hollow)
    axes.set(xticks=[], yticks=[])
    axes.margins(0.15)
    return drawn


def _draw_scene(axes: Axes, scene: Cloud, target: Object, title: str) -> None:
    """Draw an organised scene as a depth image, with the outline of the target; of others there is no more than the object."""
    if not scene.organised or target.image_shape is None:
        axes.set_axis_off()
        return
    depth = scene.xyz[..., 2]
    rows, columns = np.divmod(target.pixels, target.image_shape[1])
    near, far = float(target.cloud.xyz[:, 2].min()), float(np.nanpercentile(depth, 99.9))
    # Over less than 0.1 m, noise on a table would be all there is to see.
    axes.imshow(depth, cmap="cividis_r", vmin=min(near, far - 0.1), vmax=far)
    inside = np.zeros(depth.shape)
    inside[rows, columns] = 1.0
    axes.contour(inside, levels=[0.5], colors=_TARGET_COLOUR, linewidths=1.5)
    box = {"boxstyle": "round", "facecolor": "#202020", "edgecolor": _TARGET_COLOUR}
    style: dict[str, Any] = {"textcoords": "offset points", "color": "white", "fontsize": 9, "ha": "center"}
    axes.annotate(f"object {target.id}", (float(columns.mean()), float(rows.min())), (0, 8), bbox=box, **style)
    axes.set(xlim=_around(columns, depth.shape[1]), ylim=_around(rows, depth.shape[0])[::-1], xticks=[], yticks=[])
    axes.set_title(title, fontsize=10)


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
    style: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "fontsize": 8, "fontweight": "bold"}
    style["bbox"] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
    for k, (name, colour) in enumerate(zip(fingers, FINGER_COLOURS, strict=False)):
        axes.scatter(ends[k, 0], ends[k, 1], s=70, color=colour, edgecolors="white", zorder=3)
        place, va = (0.97, "top") if k == upper else (0.03, "bottom")
        axes.text(0.5, place, name, va=va, color=colour, **style)  # within the axes, wherever the contact is
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_xlabel("x [m]", fontsize=8)
    axes.set_ylabel("y [m]", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.locator_params(nbins=3)
    axes.set_title(f"grasp, {1e3 * grasp.width_m:.0f} mm wide", fontsize=10)


def _around(places: Any, size: int) -> tuple[float, float]:
    """First and last row or column of what is shown of an image: the target, and twice as much on each side."""
    low, high = float(places.min()), float(places.max())
    margin = 2.0 * (high - low)
    return max(low - margin, 0.0), min(high + margin, size - 1.0)
