# SPDX-License-Identifier: Apache-2.0
"""Draw grasps: the object with its contacts, and both fingertips with their electrodes.

`save_touch_picture` draws one prediction, `save_contact_sheet` many labelled samples on one page.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from foretouch.pipeline import FoundObject
from foretouch.report.panels import new_figure, save
from foretouch.tactile import electrode_positions
from foretouch.types import Cloud, Float64, Grasp, GraspSample, Touch, TouchPrediction

FINGER_COLOURS = {"TH": "#d1495b", "MF": "#00798c"}  # of g1, g2 in the order of the models: thumb, middle finger
_FINGER_NAMES = {"TH": "thumb", "MF": "middle finger"}
_SHEET_COLUMNS = 2  # samples side by side
_SHEET_DPI = 100
_SHEET_ROW_INCHES = 2.9
_LEAST_RANGE_M = 0.4  # of depth, from white to black: otherwise a table seen from above would be black
_MAX_POINTS = 6000  # more make a scatter plot slower, not denser


def save_touch_picture(
    path: str | Path,
    scene: Cloud | None,
    target: FoundObject,
    prediction: TouchPrediction,
    *,
    rest: Touch | None = None,
    read: Touch | None = None,
    title: str = "",
) -> Path:
    """Write one PNG: scene, object with contacts, electrodes of thumb and middle finger.

    Args:
        path: Path of the file; its folder is created.
        scene: The whole cloud, or None if there is only the object.
        target: The object.
        prediction: The prediction; a refused one is drawn without fingers.
        rest: Reading without contact; electrodes are then coloured by their drop from it.
        read: Reading of the executed grasp, which is drawn below the prediction with the same colour scale.
        title: Title of the figure.

    Returns:
        The path.
    """
    rows = {name: touch for name, touch in (("predicted", prediction.value), ("read", read)) if touch is not None}
    beside = len(rows) < 2  # scene and object side by side, else one above the other
    figure = new_figure(13.0, 4.6) if beside else new_figure(11.5, 8.6)
    figure.suptitle(title)
    widths = [1.35, 1.1, 0.8, 0.8] if beside else [1.2, 0.8, 0.8]
    grid = figure.add_gridspec(max(1, len(rows)), len(widths), width_ratios=widths)
    draw_scene(figure.add_subplot(grid[0, 0]), scene if scene is not None else target.cloud, target)
    draw_front(figure.add_subplot(grid[0, 1] if beside else grid[1, 0]), target.cloud, prediction.grasp)
    for column, name in enumerate(FINGER_COLOURS, 2 if beside else 1):
        axes = [figure.add_subplot(grid[row, column]) for row in range(len(rows))]
        _draw_finger(axes, name, rows, rest, _half_width(prediction, name))
    if prediction.value is None:
        figure.suptitle("\n".join(filter(None, (title, f"not predicted: {prediction.reason}"))))
    return save(figure, Path(path))


def save_contact_sheet(path: str | Path, samples: Sequence[GraspSample], title: str = "") -> Path:
    """Write one PNG with the clouds, contacts and readings of labelled samples.

    Args:
        path: Path of the file; its folder is created.
        samples: Samples in order; an unlabelled one is drawn without fingers.
        title: Title of the figure.

    Returns:
        The path.
    """
    rows = max(1, -(-len(samples) // _SHEET_COLUMNS))
    figure = new_figure(7.2 * _SHEET_COLUMNS, _SHEET_ROW_INCHES * rows + 0.4)
    figure.suptitle(title)
    grid = figure.subplots(rows, 3 * _SHEET_COLUMNS, squeeze=False, width_ratios=[1.1, 0.8, 0.8] * _SHEET_COLUMNS)
    for axes in grid.flat:
        axes.set_axis_off()
    for k, sample in enumerate(samples):
        row, column = divmod(k, _SHEET_COLUMNS)
        _draw_sample(list(grid[row, 3 * column : 3 * column + 3]), sample)
    return save(figure, Path(path), _SHEET_DPI)


def _draw_sample(panels: Sequence[Axes], sample: GraspSample) -> None:
    front, *fingers = panels
    front.set_axis_on()
    draw_front(front, sample.cloud, sample.grasp)
    front.set_title(f"{sample.id}, {1e3 * sample.grasp.width_m:.0f} mm", fontsize=9)
    if sample.touch is None:
        return
    for axes, (name, colour) in zip(fingers, FINGER_COLOURS.items(), strict=True):
        axes.set_axis_on()
        pdc, electrodes = _finger(sample.touch, name)
        rest = None if sample.tare is None else _finger(sample.tare, name)[1]
        draw_electrodes(axes, electrodes, rest, colour=colour)
        force = sample.extra.get(f"force_{name.lower()}_n")
        suffix = "" if force is None else f", {force:.1f} N"
        axes.set_title(f"{_FINGER_NAMES[name].split()[0]}, PDC {pdc:.0f}{suffix}", fontsize=9, color=colour)


def _half_width(prediction: TouchPrediction, name: str) -> float | None:
    """Half width of the interval of one finger's pressure [counts]; None without a calibration."""
    if prediction.lower is None or prediction.upper is None:
        return None
    return (_finger(prediction.upper, name)[0] - _finger(prediction.lower, name)[0]) / 2.0


def _draw_finger(
    rows: list[Axes], name: str, touches: dict[str, Touch], rest: Touch | None, half_width: float | None
) -> None:
    """Draw one fingertip of several touches, one below the other with the same colour scale."""
    readings = {what: _finger(touch, name) for what, touch in touches.items()}
    at_rest = None if rest is None else _finger(rest, name)[1]
    shown = [electrodes if at_rest is None else at_rest - electrodes for _, electrodes in readings.values()]
    limits = (float(np.min(shown)), float(np.max(shown))) if shown else None
    for axes, (what, (pdc, electrodes)) in zip(rows, readings.items(), strict=True):
        draw_electrodes(axes, electrodes, at_rest, colour=FINGER_COLOURS[name], limits=limits)
        interval = f" ± {half_width:.0f}" if what == "predicted" and half_width is not None else ""
        axes.set_title(
            f"{_FINGER_NAMES[name]} {what}\nPDC {pdc:.0f}{interval}", color=FINGER_COLOURS[name], fontsize=11
        )


def _finger(touch: Touch, name: str) -> tuple[float, Float64]:
    return (touch.pdc_th, touch.e_th) if name == "TH" else (touch.pdc_mf, touch.e_mf)


def draw_scene(axes: Axes, scene: Cloud, target: FoundObject) -> None:
    """Draw the scene from the camera, shaded by depth, with the target tinted.

    An organised cloud is drawn as a depth image, an unorganised one as points with x right and y down [m].
    """
    if scene.organised and target.pixels is not None and target.image_shape is not None:
        depth = scene.xyz[..., 2]
        near, far = np.nanpercentile(depth, [0.1, 99])
        axes.imshow(depth, cmap="Greys", vmin=near, vmax=max(far, near + _LEAST_RANGE_M))
        tint = np.full(depth.shape, np.nan)
        tint[np.divmod(target.pixels, target.image_shape[1])] = 1.0
        axes.imshow(tint, cmap="Wistia", vmin=0, vmax=1)
        axes.set(xticks=[], yticks=[], title="what the camera sees")
        return
    points = _finite_subset(scene)
    axes.scatter(points[:, 0], points[:, 1], s=1, c=points[:, 2], cmap="Greys", linewidths=0)
    _as_image(axes, "what the camera sees")


def draw_front(axes: Axes, target: Cloud, grasp: Grasp) -> None:
    """Draw the object from the camera, with both contacts and the line between them [m]."""
    points = _finite_subset(target)
    axes.scatter(points[:, 0], points[:, 1], s=3, c=points[:, 2], cmap="cividis_r", linewidths=0)
    ends = np.stack([grasp.g1, grasp.g2])
    axes.plot(ends[:, 0], ends[:, 1], color="black", linewidth=1)
    for (name, contact), end in zip((("TH", "g1"), ("MF", "g2")), ends, strict=True):
        axes.scatter(end[0], end[1], s=70, color=FINGER_COLOURS[name], edgecolors="white", zorder=3, label=contact)
    axes.legend(loc="upper right", fontsize=8)
    _as_image(axes, f"grasp, {1e3 * grasp.width_m:.0f} mm wide")


def draw_electrodes(
    axes: Axes, electrodes: Float64, rest: Float64 | None, *, colour: str, limits: tuple[float, float] | None = None
) -> None:
    """Draw the 24 electrodes of one fingertip, unrolled from the core.

    Args:
        axes: The axes.
        electrodes: (24,) counts.
        rest: (24,) counts without contact, or None to colour by the counts themselves.
        colour: Colour of the outlines.
        limits: Limits of the colour scale [counts]; None for those of the values.
    """
    x, y, z = 1e3 * electrode_positions().T
    around = np.degrees(np.arctan2(y, -z))
    values = electrodes if rest is None else rest - electrodes
    low, high = limits or (float(values.min()), float(values.max()))
    colours = "viridis_r" if rest is None else "magma_r"  # both dark at the high end
    drawn = axes.scatter(around, x, s=190, c=values, cmap=colours, vmin=low, vmax=high, edgecolors=colour)
    for k, (angle, along, value) in enumerate(zip(around, x, values, strict=True), 1):
        ink = "white" if value > (low + high) / 2.0 else "black"
        axes.annotate(str(k), (angle, along), ha="center", va="center", fontsize=6, color=ink)
    label = "electrode [counts]" if rest is None else "drop from rest [counts]"
    axes.figure.colorbar(drawn, ax=axes, location="bottom", label=label, shrink=0.9)
    axes.set(xlabel="around the core [°]", ylabel="along the finger [mm]")
    axes.margins(0.15)


def _finite_subset(cloud: Cloud) -> Float64:
    points = cloud.xyz.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    step = max(1, len(points) // _MAX_POINTS)
    return points[::step].astype(np.float64)


def _as_image(axes: Axes, title: str) -> None:
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title)
