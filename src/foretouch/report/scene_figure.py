# SPDX-License-Identifier: Apache-2.0
"""Draw a scene, one of its grasps from two sides, and the touch that is predicted for it; the drawing of `foretouch.draw`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.errors import ConfigError
from foretouch.files import as_path
from foretouch.report.hand_figure import COLOURS, hand_lines
from foretouch.report.panels import FINGER_COLOURS, Axes, new_figure, save, some_points, without_formulas
from foretouch.tactile.channels import finger_label
from foretouch.tactile.taxel_view import scalars_text
from foretouch.types import Bool, Cloud, Float64, Grasp, Grasps, Prediction, Predictions
from foretouch.types.scene import Object, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEIGHT: Final = 3.4  # of a panel [inch]
_COLOURS: Final = ("#ff8000", "#00a6d6", "#e6007e", "#7ab800", "#8f4fd1", "#d9b300", "#00a88f", "#d1495b")
_DARK: Final = "#202020"
_TABLE: Final = "#8a6d3b"
_AROUND_M: Final = 0.06  # shown around object and grasp
_HAND_M: Final = 0.15  # as far a hand is shown beyond the object
_LABELS: Final = 40  # objects with an id; more cover the picture


def draw_scene(
    scene: Scene | Object,
    grasps: Grasps | None = None,
    touch: Predictions | None = None,
    *,
    path: str | Path | None = None,
    number: int = 0,
) -> Figure:
    """Draw the image with its objects, a grasp from above and from the side, and its predicted touch.

    Args:
        scene: What was found in a cloud; or one object, of which there is no image.
        grasps: On one object.
        touch: Predictions for them.
        path: File to write, whose suffix is the format; its folder is made.
        number: Which grasp is drawn.

    Returns:
        The figure, in which panels without content are left out.

    Raises:
        ConfigError: If there is no grasp of that number, or no object to it, or what is drawn is neither a scene nor an object.
        GraspError: If the grasps are no sequence.
        FileError: If the file cannot be written.
    """
    _check_types(scene, touch)
    grasps = touch.grasps if grasps is None and touch is not None else Grasps.of([] if grasps is None else grasps)
    grasp = None
    if len(grasps):
        if not 0 <= number < len(grasps):
            raise ConfigError(f"number: {number} is not one of the {len(grasps)} grasps, 0 to {len(grasps) - 1}")
        grasp = grasps[number]
    if isinstance(scene, Object) and grasp is not None and grasp.object_id not in ("", scene.id):
        raise ConfigError(f"grasps: are on object {grasp.object_id}, not on {scene.id}")
    target = scene if isinstance(scene, Object) else _object_of(scene, grasp)
    prediction = None if touch is None or grasp is None else touch[number]
    image = isinstance(scene, Scene) and scene.cloud.organised
    left, right, top, bottom = _window(scene.labels > 0) if isinstance(scene, Scene) and image else (0, 1, 0, 1)
    widths = []
    if image:
        widths.append(_HEIGHT * float(np.clip((right - left) / (bottom - top), 0.6, 1.9)))
    if target is not None and (grasp is not None or not image):
        widths += [_HEIGHT, _HEIGHT]
    if prediction is not None:
        widths.append(1.6 * _HEIGHT)
    figure = new_figure(sum(widths or [_HEIGHT]), _HEIGHT + 0.5)
    panels = iter(np.atleast_1d(figure.subplots(1, len(widths or [1]), width_ratios=widths or None)))
    if not widths:
        next(panels).set_axis_off()
    if isinstance(scene, Scene) and image:
        _draw_image(next(panels), scene, grasp)
    if target is not None and (grasp is not None or not image):
        others = [object_ for object_ in scene.objects if object_ is not target] if isinstance(scene, Scene) else []
        _draw_sides(next(panels), next(panels), target, others, grasp)
    if prediction is not None:
        _draw_touch(next(panels), prediction)
    if path is not None:
        save(figure, as_path(path))
    return without_formulas(figure)


def _check_types(scene: object, touch: object) -> None:
    """Refuse what is neither a scene nor an object, or no predictions; a `ConfigError`."""
    if not isinstance(scene, Scene | Object):
        raise ConfigError(f"scene: {type(scene).__name__} is neither a Scene, such as of segment(cloud), nor an Object")
    if not isinstance(touch, Predictions | None):
        raise ConfigError(f"touch: {type(touch).__name__} is not Predictions, such as of model.predict(object, grasps)")


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


def _draw_image(axes: Axes, scene: Scene, grasp: Grasp | None) -> None:
    """Draw the image in colour, or its depth, with the outlines of the table and of each object, ids and contacts."""
    depth = scene.cloud.xyz[..., 2]
    if scene.cloud.rgb is not None:
        axes.imshow(scene.cloud.rgb)
    elif np.isfinite(depth).any():
        near, far = np.nanpercentile(depth[np.isfinite(depth)], [1.0, 97.0])
        axes.imshow(depth, cmap="gray_r", vmin=near - 0.1, vmax=max(far, near + 0.1))
    if len(scene.outline):
        corners = _pixels(scene.cloud, scene.outline)
        axes.fill(corners[:, 0], corners[:, 1], fill=False, edgecolor=_TABLE, linewidth=1.4, linestyle="--")
    for k, object_ in enumerate(scene.objects):
        colour = _COLOURS[k % len(_COLOURS)]
        inside = (scene.labels == int(object_.id)).astype(np.float32)
        axes.contour(inside, levels=[0.5], colors=colour, linewidths=1.4)
        if k < _LABELS:
            rows, columns = np.nonzero(inside)
            place = float(np.median(columns)), float(np.median(rows))
            axes.annotate(object_.id, place, color="white", fontsize=8, fontweight="bold", ha="center", va="center",
                          bbox={"boxstyle": "round,pad=0.15", "facecolor": colour, "edgecolor": "none", "alpha": 0.85})  # fmt: skip
    if grasp is not None:
        ends = _pixels(scene.cloud, np.stack([grasp.g1, grasp.g2]))
        axes.plot(ends[:, 0], ends[:, 1], color="white", linewidth=2.5)
        axes.plot(ends[:, 0], ends[:, 1], color=_DARK, linewidth=1.0)
        for (u, v), colour in zip(ends, FINGER_COLOURS, strict=False):
            axes.plot(u, v, "o", color=colour, markeredgecolor="white", markersize=6)
    left, right, top, bottom = _window(scene.labels > 0)
    axes.set(xlim=(left - 0.5, right - 0.5), ylim=(bottom - 0.5, top - 0.5), xticks=[], yticks=[], aspect="equal")
    count = len(scene.objects)
    title = f"{count} object{'' if count == 1 else 's'} on the table"
    if not count:
        title = f"{scene.status}: {scene.reason}"
    axes.set_title(_folded(title, 60), fontsize=9)


def _window(inside: Bool) -> tuple[int, int, int, int]:
    """First and last column and row of what is shown of an image: all objects, and as much around them."""
    height, width = inside.shape
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return 0, width, 0, height
    margin = max(40, int(max(np.ptp(rows), np.ptp(columns)) // 3))
    left, right = max(0, int(columns[0]) - margin), min(width, int(columns[-1]) + margin + 1)
    top, bottom = max(0, int(rows[0]) - margin), min(height, int(rows[-1]) + margin + 1)
    return left, right, top, bottom


def _pixels(cloud: Cloud, points: Float64) -> Float64:
    """Return (K, 2) columns and rows at which the camera sees points (K, 3); a camera that is not known is fitted to the image."""
    rays = cloud.xyz[..., :2] / cloud.xyz[..., 2:]
    known = np.isfinite(rays).all(axis=2)
    places = []
    for axis, index in enumerate(np.indices(known.shape)[::-1]):
        slope, start = np.polyfit(rays[..., axis][known].astype(np.float64), index[known].astype(np.float64), 1)
        places.append(slope * points[:, axis] / points[:, 2] + start)
    return np.stack(places, axis=1)


def _draw_sides(above: Axes, side: Axes, target: Object, others: Sequence[Object], grasp: Grasp | None) -> None:
    """Draw an object with its contacts and closing line, from above the table and from the side [mm]; the line is horizontal."""
    points, table = some_points(target.cloud), target.plane.towards_camera  # a table that was stated may face away
    up = table.normal
    along = grasp.g1 - grasp.g2 if grasp is not None else np.array([1.0, 0.0, 0.0])
    along = along - up * (along @ up)
    along = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-9 else np.linalg.svd(up[None])[2][1]
    across = np.cross(up, along)
    centre = grasp.midpoint if grasp is not None else points.mean(axis=0)

    def flat(xyz: Float64) -> Float64:
        """Return (N, 3): along the closing line and across it from the midpoint, and height above the table [mm]."""
        moved = xyz - centre
        return 1e3 * np.stack([moved @ along, moved @ across, xyz @ up + table.offset], axis=1)

    own = flat(points)
    ends = np.empty((0, 3)) if grasp is None else flat(np.stack([grasp.g1, grasp.g2]))
    hand = {} if grasp is None else hand_lines(grasp)
    lines = {part: flat(edges.reshape(-1, 3)).reshape(-1, 2, 3) for part, edges in hand.items()}
    low, high = (f(np.concatenate([own, ends]), axis=0) for f in (np.min, np.max))
    if lines:  # the hand, but not the whole forearm
        near = np.clip(np.concatenate(list(lines.values())), low - 1e3 * _HAND_M, high + 1e3 * _HAND_M)
        low, high = np.minimum(low, near.min(axis=(0, 1))), np.maximum(high, near.max(axis=(0, 1)))
    span = 1.15 * max(*(high - low)[:2] + 2e3 * _AROUND_M, high[2] + 1e3 * _AROUND_M)  # of both panels
    for axes, row, name in ((above, 1, "from above"), (side, 2, "from the side")):
        for other in others:
            rest = flat(some_points(other.cloud))
            axes.scatter(rest[:, 0], rest[:, row], s=2, color="#c8c8c8", linewidths=0)
        axes.scatter(own[:, 0], own[:, row], s=4, c=own[:, 3 - row], cmap="cividis", linewidths=0)
        for part, edges in lines.items():
            axes.plot(edges[..., 0].T, edges[..., row].T, color=COLOURS[part], linewidth=0.9, alpha=0.8)
        if grasp is not None:
            axes.plot(ends[:, 0], ends[:, row], color=_DARK, linewidth=1.2)
            for k, (finger, colour) in enumerate(zip(("g1", "g2"), FINGER_COLOURS, strict=False)):
                outward = 1.0 if ends[k, 0] >= ends[1 - k, 0] else -1.0
                tail = ends[k, 0] + outward * 26.0, ends[k, row]
                axes.annotate("", (ends[k, 0], ends[k, row]), tail, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.0})  # fmt: skip
                axes.plot(ends[k, 0], ends[k, row], "o", color=colour, markeredgecolor="white", markersize=7, zorder=4)
                axes.annotate(finger, tail, (8.0 * outward, 0.0), textcoords="offset points", color=colour, fontsize=9,
                              fontweight="bold", ha="center", va="center",
                              bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})  # fmt: skip
        middle = (low + high) / 2.0
        bottom = -0.08 * span if row == 2 else middle[1] - 0.5 * span
        axes.set(xlim=(middle[0] - 0.5 * span, middle[0] + 0.5 * span), ylim=(bottom, bottom + span), aspect="equal")
        axes.set_xlabel("along the closing line [mm]" if grasp is not None else "x [mm]", fontsize=8)
        axes.set_ylabel("across [mm]" if row == 1 else "height above the table [mm]", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.set_title(name, fontsize=9)
    side.axhline(0.0, color=_TABLE, linewidth=1.5)
    width = f", {1e3 * np.linalg.norm(grasp.g1 - grasp.g2):.0f} mm wide" if grasp is not None else ""
    above.set_title(f"object {target.id or '1'} from above{width}", fontsize=9)


def _draw_touch(axes: Axes, prediction: Prediction) -> None:
    """Draw the taxels of both fingers with their intervals, in the unit of their channel, and the scalars as text."""
    channels = prediction.channels
    if not prediction.ok:
        axes.set_axis_off()
        axes.text(0.5, 0.5, _folded(f"not predicted: {prediction.reason}", 40), ha="center", va="center", fontsize=9)
        return
    taxels = [channel for channel in channels.channels if channel.size > 1] or list(channels.channels)
    shown = next((taxel for taxel in reversed(taxels) if taxel.contact), taxels[-1])
    value, lower, upper = (np.atleast_2d(end.T).T if end.ndim == 1 else end for end in prediction[shown.name])
    number = np.arange(1, value.shape[1] + 1)
    for k, finger in enumerate(channels.fingers):
        shift = 0.16 * (2 * k - len(channels.fingers) + 1)
        bars = None if np.isnan(lower[k]).any() else np.abs(np.stack([value[k] - lower[k], upper[k] - value[k]]))
        style: dict[str, Any] = {
            "fmt": "o",
            "markersize": 3.5,
            "linewidth": 1.2,
            "color": FINGER_COLOURS[k % len(FINGER_COLOURS)],
        }
        axes.errorbar(number + shift, value[k], bars, label=_finger_text(prediction, k, finger_label(finger)), **style)
    axes.set_xlabel(f"taxel of {channels.sensor}", fontsize=8)
    axes.set_ylabel(f"{shown.name} [{shown.unit}]" if shown.unit else shown.name, fontsize=8)
    axes.tick_params(labelsize=7)
    if len(number) <= 32:
        axes.set_xticks(number[:: max(1, len(number) // 12)])
    axes.grid(axis="y", color="#e5e5e5")
    axes.set_axisbelow(True)
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=len(channels.fingers), frameon=False)
    flags = f": {', '.join(prediction.flags).replace('_', ' ')}" if prediction.flags else ""
    interval = " with 90 % intervals" if prediction.calibrated else ", no intervals: the model is not calibrated"
    axes.set_title(_folded(f"predicted touch{interval}{flags}", 62), fontsize=9)


def _finger_text(prediction: Prediction, finger: int, name: str) -> str:
    """Return the name and scalars of a finger, such as `thumb (g1): PDC 2779 ± 60`."""
    scalars = [channel for channel in prediction.channels.channels if channel.size == 1]
    text = scalars_text(scalars, finger, prediction.value, prediction)
    at = f" (g{finger + 1})" if finger < 2 else ""
    return f"{name}{at}: {text}" if text else f"{name}{at}"


def _folded(text: str, width: int) -> str:
    from textwrap import fill

    return fill(text, width)
