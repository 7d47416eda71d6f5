# SPDX-License-Identifier: Apache-2.0
"""Draw a scene, one of its grasps from two sides, and the touch that is predicted for it; the drawing of `foretouch.draw`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Final

import numpy as np

from foretouch.base.files import as_path
from foretouch.errors import ConfigError, none_of, quoted, require_type, shown
from foretouch.grasp.geograsp import unseen_side
from foretouch.report.camera_figure import draw_scene_image, shown_of, window_of
from foretouch.report.finger_figure import FingerScale, finger_levels, title_finger
from foretouch.report.hand_figure import draw_boxes, draw_unseen, finger_names, hand_boxes
from foretouch.report.panels import (
    FINGER_COLOURS,
    INK,
    PAGE_INCH,
    SMALL_PT,
    TABLE,
    TEXT_PT,
    Axes,
    new_figure,
    save,
    some_points,
    without_formulas,
)
from foretouch.tactile.channels import finger_label
from foretouch.tactile.description import Sensor, packaged_sensor, require_same, sensor_files
from foretouch.tactile.taxel_view import TaxelView, scalars_text
from foretouch.types import Float64, Grasp, Grasps, Prediction, Predictions, Touch
from foretouch.types.channels import Channels
from foretouch.types.scene import Object, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure, FigureBase, SubFigure

PANELS: Final = ("image", "touch", "above", "side")
"""What a picture may have, in its order: two in a row."""

_SIDE_INCH: Final = 3.2  # height of the views of a grasp
_AROUND_M: Final = 0.03  # shown around object and grasp
_SEEN_MM: Final = 8.0  # from a contact to the nearest point of a side that the camera saw
_SAME_M: Final = 1e-6  # between contacts of one grasp
_HAND_M: Final = 0.15  # as far a hand is shown beyond the object


def draw_scene(
    scene: Scene | Object,
    grasps: Grasps | None = None,
    touch: Predictions | None = None,
    *,
    path: str | Path | None = None,
    number: int = 0,
    panels: Sequence[str] = PANELS,
    rest: Touch | None = None,
    sensor: Sensor | None = None,
) -> Figure:
    """Draw the image with its objects, a grasp from above and from the side, and its predicted touch on both fingers.

    Args:
        scene: What was found in a cloud; or one object, of which there is no image.
        grasps: On one object.
        touch: Predictions for them.
        path: File to write, whose suffix is the format; its folder is made.
        number: Which grasp is drawn.
        panels: Which of `image`, `touch`, `above` and `side` are drawn.
        rest: Reading without contact; taxels are then coloured by their change from it.
        sensor: The sensor that is predicted, if it is none of the package.

    Returns:
        The figure, in which panels without content are left out.

    Raises:
        ConfigError: If there is no grasp of that number, or no object to it, a panel is unknown, or what is drawn is neither a scene
            nor an object.
        GraspError: If the grasps are no sequence.
        FileError: If the file cannot be written.
    """
    _check_types(scene, touch, panels)
    require_type(rest, Touch | None, "rest", "not a Touch, such as model.rest", ConfigError)
    require_type(sensor, Sensor | None, "sensor", "not a Sensor, such as model.sensor", ConfigError)
    grasps = touch.grasps if grasps is None and touch is not None else Grasps.of([] if grasps is None else grasps)
    whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
    if not whole or (len(grasps) and not 0 <= number < len(grasps)):
        raise ConfigError(f"number: {quoted(number)} is not one of the {len(grasps)} grasps, 0 to {len(grasps) - 1}")
    grasp = grasps[number] if len(grasps) else None
    if touch is not None and len(grasps) and not _are_of(touch, grasps, number):
        raise ConfigError(f"touch: predicts another grasp than number {number} of grasps")
    if isinstance(scene, Object) and grasp is not None and grasp.object_id not in ("", scene.id):
        raise ConfigError(f"grasps: are on object {grasp.object_id}, not on {scene.id}")
    target = scene if isinstance(scene, Object) else _object_of(scene, grasp)
    prediction = None if touch is None or grasp is None else touch[number]
    image = isinstance(scene, Scene) and scene.cloud.organised
    sides = target is not None and (grasp is not None or not image)
    there = {"image": image, "above": sides, "side": sides, "touch": prediction is not None}
    shown = [name for name in PANELS if there[name] and name in panels]
    figure, parts = _new_page(shown, scene, grasp)
    if isinstance(scene, Scene) and "image" in parts:
        axes = parts["image"].subplots()
        draw_scene_image(axes, scene, grasp)
        axes.set_title(_image_title(scene), fontsize=TEXT_PT)
    if target is not None and sides:
        others = [object_ for object_ in scene.objects if object_ is not target] if isinstance(scene, Scene) else []
        views: dict[str, Axes] = {name: parts[name].subplots() for name in PANELS[2:] if name in parts}
        _draw_sides(views, target, others, grasp)
    if prediction is not None and "touch" in parts:
        _draw_touch(parts["touch"], prediction, rest, sensor)
    if path is not None:
        save(figure, as_path(path))
    return without_formulas(figure)


def _new_page(panels: Sequence[str], scene: Scene | Object, grasp: Grasp | None) -> tuple[Figure, dict[str, SubFigure]]:
    """Return an empty figure with a part for each panel."""
    rows = [row for row in (panels[:2], panels[2:]) if row]
    heights = [_height(row, scene, grasp) for row in rows] or [_SIDE_INCH]
    figure = new_figure(PAGE_INCH, sum(heights))
    grid = figure.add_gridspec(len(heights), height_ratios=heights)
    parts: dict[str, SubFigure] = {}
    for line, row in enumerate(rows):
        part = figure.add_subfigure(grid[line])
        parts |= dict(zip(row, np.atleast_1d(np.asarray(part.subfigures(1, len(row)))), strict=True))
    return figure, parts


def _are_of(touch: Predictions, grasps: Grasps, number: int) -> bool:
    """Return whether a prediction has the contacts of a grasp; also one without contacts, as of messages, or without values."""
    if number >= len(touch):
        return False
    ends = [(getattr(of, name)[number] for of in (touch.grasps, grasps)) for name in ("g1", "g2")]
    near = all(np.isnan(own).any() or np.allclose(own, wanted, atol=_SAME_M) for own, wanted in ends)
    return near or not touch.ok[number]


def _check_types(scene: object, touch: object, panels: Sequence[str]) -> None:
    """Refuse what is neither a scene nor an object, no predictions or no panel; a `ConfigError`."""
    if not isinstance(scene, Scene | Object):
        raise ConfigError(f"scene: {type(scene).__name__} is neither a Scene, such as of segment(cloud), nor an Object")
    if not isinstance(touch, Predictions | None):
        raise ConfigError(f"touch: {type(touch).__name__} is not Predictions, such as of model.predict(object, grasps)")
    if isinstance(panels, str) or not isinstance(panels, Sequence):
        raise ConfigError(f"panels: {shown(panels)} is not a list of {', '.join(PANELS)}")
    for name in panels:
        if name not in PANELS:
            raise ConfigError(f"panels: {none_of(name, PANELS)}")


def _object_of(scene: Scene, grasp: Grasp | None) -> Object | None:
    """Return the object of a grasp, or the first one that gets grasps."""
    known = {object_.id: object_ for object_ in scene.objects}
    if grasp is not None and grasp.object_id:
        if grasp.object_id not in known:
            raise ConfigError(
                f"grasps: object {grasp.object_id} is not in the scene, whose objects are {', '.join(known)}"
            )
        return known[grasp.object_id]
    return next(iter(scene.targets or scene.objects), None)


def _height(row: Sequence[str], scene: Scene | Object, grasp: Grasp | None) -> float:
    """Return the height of a row of panels [inch]."""
    if "image" not in row or not isinstance(scene, Scene):
        return _SIDE_INCH
    left, right, top, bottom = window_of(*shown_of(scene, grasp))
    return (
        float(np.clip(PAGE_INCH / len(row) * (bottom - top) / (right - left), 2.4, 3.9 if len(row) > 1 else 5.4)) + 0.3
    )


def _image_title(scene: Scene) -> str:
    count, known = len(scene.objects), [one.confidence for one in scene.objects if one.confidence is not None]
    title = f"what the camera sees: {count} object{'' if count == 1 else 's'} found"
    title += f", {sum(share >= 0.5 for share in known)} probably whole" if known else ""
    return fill(f"{title}; dashed: what they stand on" if count else f"{scene.status}: {scene.reason}", 58)


def _draw_sides(views: Mapping[str, Axes], target: Object, others: Sequence[Object], grasp: Grasp | None) -> None:
    """Draw an object with its contacts and closing line, from above the table and from the side [mm]; the line is horizontal."""
    points, table = some_points(target.cloud), target.plane.towards_camera  # a table that was stated may face away
    up = table.normal
    along = grasp.g1 - grasp.g2 if grasp is not None else np.array([1.0, 0.0, 0.0])
    along = along - up * (along @ up)
    along = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-9 else np.linalg.svd(up[None])[2][1]
    across = np.cross(up, along)
    centre = grasp.midpoint if grasp is not None else points.mean(axis=0)

    def flat(xyz: Float64) -> Float64:
        """Return (..., 3): along the closing line and across it from the midpoint, and height above the table [mm]."""
        moved = xyz - centre
        return 1e3 * np.stack([moved @ along, moved @ across, xyz @ up + table.offset], axis=-1)

    own, unseen = flat(points), flat(unseen_side(target))
    ends = np.empty((0, 3)) if grasp is None else flat(np.stack([grasp.g1, grasp.g2]))
    hand = {} if grasp is None else {part: flat(boxes) for part, boxes in hand_boxes(grasp).items()}
    low, high = (f(np.concatenate([own, unseen, ends]), axis=0) for f in (np.min, np.max))
    if hand:  # but not the whole forearm
        near = np.clip(np.concatenate(list(hand.values())), low - 1e3 * _HAND_M, high + 1e3 * _HAND_M)
        low, high = np.minimum(low, near.min(axis=(0, 1))), np.maximum(high, near.max(axis=(0, 1)))
    span = 1.15 * max(*(high - low)[:2] + 2e3 * _AROUND_M, high[2] + 1e3 * _AROUND_M)  # of both panels
    width = f", {1e3 * np.linalg.norm(grasp.g1 - grasp.g2):.0f} mm wide" if grasp is not None else ""
    title = f"grasp on object {target.id or '1'}{width}" if grasp is not None else f"object {target.id or '1'}"
    for name, axes in views.items():
        row = {"above": 1, "side": 2}[name]
        reach = np.concatenate([own, unseen, ends, *(boxes.reshape(-1, 3) for boxes in hand.values())])[:, 3 - row]
        for other in others:
            rest = flat(some_points(other.cloud))
            rest = rest[(rest[:, 3 - row] >= reach.min()) & (rest[:, 3 - row] <= reach.max())]
            axes.scatter(rest[:, 0], rest[:, row], s=2, color="#b8b8b8", linewidths=0)
        axes.scatter(own[:, 0], own[:, row], s=4, c=own[:, 3 - row], cmap="cividis", linewidths=0)
        stands = [own, own * [1.0, 1.0, 0.0]] if row == 2 else []  # on the table
        hidden = np.concatenate([unseen, *stands])
        draw_unseen(axes, own[:, [0, row]], hidden[:, [0, row]])
        for part, boxes in hand.items():
            draw_boxes(axes, boxes[..., [0, row]], part)
        if grasp is not None:
            _draw_contacts(axes, own, ends[:, [0, row]], ends, 0.1 * span, finger_names(grasp))
        middle = (low + high) / 2.0
        bottom = -0.08 * span if row == 2 else middle[1] - 0.5 * span
        axes.set(xlim=(middle[0] - 0.5 * span, middle[0] + 0.5 * span), ylim=(bottom, bottom + span), aspect="equal")
        along_line = "along the closing line [mm]; a hollow contact is estimated"
        axes.set_xlabel(along_line if grasp is not None else "x [mm]", fontsize=SMALL_PT)
        axes.set_ylabel("across [mm]" if row == 1 else "height above the table [mm]", fontsize=SMALL_PT)
        axes.tick_params(labelsize=SMALL_PT)
        place = {"above": "from above", "side": "from the side"}[name]
        axes.set_title(f"{title}: {place}" if axes is next(iter(views.values())) else place, fontsize=TEXT_PT)
        if row == 2:
            axes.axhline(0.0, color=TABLE, linewidth=1.5)


def _draw_contacts(
    axes: Axes, own: Float64, flat: Float64, ends: Float64, length: float, fingers: Sequence[str]
) -> None:
    """Draw the closing line between contacts (2, 2), whose places (2, 3) are hollow where no point (N, 3) was seen, with named arrows [mm]."""
    axes.plot(*flat.T, color=INK, linewidth=1.6, zorder=5)
    for k, (finger, colour) in enumerate(zip(fingers, FINGER_COLOURS, strict=False)):
        outward = np.sign(ends[k, 0] - ends[1 - k, 0]) or 1.0
        seen = np.linalg.norm(own - ends[k], axis=1).min() < _SEEN_MM
        tail = flat[k] + [outward * length, 0.0]
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.0}
        axes.annotate("", flat[k], tail, zorder=5, arrowprops=arrow)
        axes.plot(*flat[k], "o", color=colour, fillstyle="full" if seen else "none", markersize=7, zorder=5)
        axes.annotate(finger, flat[k], (4.0 * outward, 8.0), textcoords="offset points", color=colour, fontsize=TEXT_PT,
                      fontweight="bold", ha="left" if outward > 0.0 else "right", va="bottom", zorder=5,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})  # fmt: skip


def _draw_touch(part: FigureBase, prediction: Prediction, rest: Touch | None, sensor: Sensor | None) -> None:
    """Draw the taxels of both fingers with their intervals, or say why there are none."""
    sensor = sensor or _known_sensor(prediction.channels)
    if not prediction.ok or sensor is None:
        axes = part.subplots()
        axes.set_axis_off()
        text = f"not predicted: {prediction.reason}" if not prediction.ok else _finger_texts(prediction)
        axes.text(0.5, 0.5, fill(text, 40) if not prediction.ok else text, ha="center", va="center", fontsize=TEXT_PT)
        return
    if rest is not None:
        require_same(rest.channels, sensor.channels, "rest")
    view = TaxelView(sensor)
    tared = view.has_rest(rest)
    shown = [(k, *finger_levels(view, prediction, rest if tared else None, k)) for k in range(len(view.fingers))]
    halves = [half for *_, half in shown if half is not None]
    scale = FingerScale(view, [levels[sensor.valid[k]] for k, levels, _ in shown], halves, tared=tared)
    fingers = np.atleast_1d(part.subplots(1, len(shown)))
    for axes, (k, levels, half) in zip(fingers, shown, strict=True):
        scale.draw(axes, k, levels, half=half)
        title_finger(axes, scale, k, view.scalars(k, prediction.value, prediction))
    scale.add_bar(part, list(fingers), shrink=0.8, aspect=30)
    flags = f": {', '.join(prediction.flags).replace('_', ' ')}" if prediction.flags else ""
    without = "" if prediction.calibrated else ", without intervals: the model is not calibrated"
    part.suptitle(fill(f"predicted touch{without}{flags}", 58), fontsize=TEXT_PT)


def _known_sensor(channels: Channels) -> Sensor | None:
    """Return the sensor of the package that has these channels; None if it is another."""
    known = map(packaged_sensor, sensor_files())
    return next((sensor for sensor in known if sensor.channels == channels), None)


def _finger_texts(prediction: Prediction) -> str:
    """Return a line for each finger with its numbers, such as `thumb: PDC 2779 ± 60`, of a sensor without a known shape."""
    scalars = [channel for channel in prediction.channels.channels if channel.size == 1]
    taxels = [channel for channel in prediction.channels.channels if channel.size > 1]
    lines = []
    for k, name in enumerate(prediction.channels.fingers):
        texts = [scalars_text(scalars, k, prediction.value, prediction)]
        for channel in taxels:
            values = prediction.value[channel.name][k]
            texts.append(f"{channel.name} {channel.text(values.min())} to {channel.text(values.max())} {channel.unit}")
        lines.append(f"{finger_label(name)}: {', '.join(filter(None, texts))}")
    return "\n".join(lines)
