# SPDX-License-Identifier: Apache-2.0
"""What the camera sees: the photograph, or its depth as a shaded relief, with outlines, ids, the grasp and the hand over it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from foretouch.report.hand_figure import draw_boxes, finger_names, hand_boxes
from foretouch.report.panels import FINGER_COLOURS, INK, OBJECT_COLOURS, TABLE, TEXT_PT, Axes
from foretouch.types import Bool, Cloud, Float64, Grasp, UInt8
from foretouch.types.scene import Object, Scene

_SLIT_PX: Final = 5  # widest gap without depth that an outline passes over
_LABELS: Final = 40  # objects with an id; more cover the picture
_FITTED: Final = 4096  # points, at least, of which the camera of a cloud follows, where there are so many
_SMOOTH_PX: Final = 2.5
_LIGHT: Final = np.array([-0.45, -0.55, -0.7])  # in the camera's frame, from above to the left


def draw_camera(
    axes: Axes,
    cloud: Cloud,
    areas: Mapping[str, Bool],
    *,
    shown: Bool | None = None,
    table: Float64 | None = None,
    grasp: Grasp | None = None,
    around: float = 0.33,
    fingers: Sequence[str] = (),
) -> None:
    """Draw the image of a camera with the outline and id of each object, and a grasp with its hand.

    Args:
        axes: Where to draw.
        cloud: An organised cloud.
        areas: By id, (H, W) which pixels an object has.
        shown: (H, W) what is shown with its surroundings; None for all objects.
        table: (n, 3) corners of the table's outline [m].
        grasp: The grasp.
        around: How much is shown on each side of the objects, of their size.
        fingers: What the fingers at g1 and g2 are called; empty for what the hand calls them.
    """
    axes.imshow(photograph(cloud))
    if table is not None and len(table):
        corners = pixels_of(cloud, table)
        axes.fill(*corners.T, fill=False, edgecolor=TABLE, linewidth=1.4, linestyle="--")
    bare = ~np.isfinite(cloud.xyz[..., 2])
    taken = np.any(list(areas.values()), axis=0) if areas else np.zeros_like(bare)
    for k, inside in enumerate(areas.values()):
        colour = OBJECT_COLOURS[k % len(OBJECT_COLOURS)]
        whole = inside | (without_slits(inside) & bare & ~taken)
        for line in outlines_of(whole):
            axes.plot(*line.T, color="white", linewidth=3.2)
            axes.plot(*line.T, color=colour, linewidth=1.7)
    for k, (name, inside) in enumerate(areas.items()):
        if k < _LABELS and inside.any():
            own = grasp is not None and (len(areas) == 1 or grasp.object_id in ("", name))
            ends = pixels_of(cloud, np.stack([grasp.g1, grasp.g2])) if own and grasp is not None else None
            _name(axes, name, inside, OBJECT_COLOURS[k % len(OBJECT_COLOURS)], ends)
    if grasp is not None:
        _draw_grasp(axes, cloud, grasp, fingers or finger_names(grasp))
    left, right, top, bottom = window_of(taken if shown is None else shown, around)
    axes.set(xlim=(left - 0.5, right - 0.5), ylim=(bottom - 0.5, top - 0.5), xticks=[], yticks=[], aspect="equal")


def draw_scene_image(axes: Axes, scene: Scene, grasp: Grasp | None) -> None:
    """Draw the image of a scene with its table and objects; with a grasp only the surroundings of its object."""
    areas = {object_.id: scene.labels == int(object_.id) for object_ in scene.objects}
    shown, around = shown_of(scene, grasp)
    draw_camera(axes, scene.cloud, areas, shown=shown, table=scene.outline, grasp=grasp, around=around)


def shown_of(scene: Scene, grasp: Grasp | None) -> tuple[Bool, float]:
    """Return (H, W) what is shown of a scene, and how much around it, of its size: the object of a grasp, else all objects."""
    own = None if grasp is None else next((one for one in scene.objects if one.id == grasp.object_id), None)
    return (scene.labels > 0, 0.33) if own is None else (scene.labels == int(own.id), 0.8)


def outlines_of(inside: Bool) -> list[Float64]:
    """Return the outlines of an area (H, W) as lines (N, 2) of columns and rows, half a pixel outside."""
    from matplotlib.figure import Figure

    (path,) = Figure().subplots().contour(inside.astype(np.float32), levels=[0.5]).get_paths()
    return [np.asarray(line, np.float64) for line in path.to_polygons(closed_only=False)]


def area_of(target: Object, cloud: Cloud) -> Bool:
    """Return (H, W) which pixels of an image an object has; its own image may be smaller, as of one that was received."""
    inside = np.zeros(cloud.xyz.shape[:2], np.bool_)
    if target.image_shape is not None:
        inside[np.divmod(target.pixels, target.image_shape[1])] = True
    return inside


def photograph(cloud: Cloud) -> UInt8:
    """Return (H, W, 3) the colours of an organised cloud; without colours its depth, shaded as a relief, black where there is none."""
    if cloud.rgb is not None:
        return np.asarray(cloud.rgb)
    from scipy.ndimage import gaussian_filter

    depth = cloud.xyz[..., 2].astype(np.float64)
    known = np.isfinite(depth)
    if not known.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(depth[known], [1.0, 97.0])
    weight = gaussian_filter(known.astype(np.float64), _SMOOTH_PX)
    smooth = gaussian_filter(np.where(known, depth, 0.0), _SMOOTH_PX) / np.maximum(weight, 1e-9)
    known |= weight > 0.5  # slits
    points = np.where(known, smooth, np.nan)[..., None] * _rays(cloud)
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    with np.errstate(invalid="ignore"):
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    light = normals @ (_LIGHT / np.linalg.norm(_LIGHT))
    dark, bright = np.nanpercentile(light, [2.0, 99.0])
    light = np.nan_to_num(np.clip((light - dark) / max(bright - dark, 0.9), 0.0, 1.0), nan=0.5)
    nearness = 1.0 - np.clip((smooth - near) / max(far - near, 0.1), 0.0, 1.0)
    grey = np.where(known, 50.0 + 195.0 * (0.5 + 0.5 * nearness) * (0.4 + 0.6 * light), 20.0)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def _rays(cloud: Cloud) -> Float64:
    """Return (H, W, 3) the ray of each pixel, one metre deep, as the fit of `pixels_of` has them."""
    slopes, starts = _camera(cloud)
    rows, columns = np.indices(cloud.xyz.shape[:2])
    x, y = (columns - starts[0]) / slopes[0], (rows - starts[1]) / slopes[1]
    return np.stack([x, y, np.ones_like(x)], axis=2)


def _camera(cloud: Cloud) -> tuple[Float64, Float64]:
    """Return focal lengths and principal point [px] of (column, row), fitted to a sample of the points of an organised cloud."""
    known = np.flatnonzero(np.isfinite(cloud.xyz).all(axis=2))
    few = known[:: max(1, len(known) // _FITTED)]
    rows, columns = np.divmod(few, cloud.xyz.shape[1])
    xyz = cloud.xyz[rows, columns].astype(np.float64)
    rays = xyz[:, :2] / xyz[:, 2:]
    slopes, starts = np.array([np.polyfit(rays[:, k], places, 1) for k, places in enumerate((columns, rows))]).T
    return slopes, starts


def pixels_of(cloud: Cloud, points: Float64) -> Float64:
    """Return (K, 2) columns and rows at which the camera of an organised cloud sees points (K, 3) [m]."""
    slopes, starts = _camera(cloud)
    places: Float64 = slopes * points[..., :2] / points[..., 2:] + starts
    return places


def without_slits(inside: Bool) -> Bool:
    """Return an area without its slits of a few pixels, such as rows without depth of a registered image."""
    from scipy.ndimage import binary_closing

    padded = np.pad(inside, _SLIT_PX)
    closed: Bool = binary_closing(padded, np.ones((_SLIT_PX, _SLIT_PX)))[_SLIT_PX:-_SLIT_PX, _SLIT_PX:-_SLIT_PX]
    return closed


def window_of(inside: Bool, around: float = 0.33) -> tuple[int, int, int, int]:
    """Return first and last column and row of what is shown of an image: all objects, and as much around them."""
    height, width = inside.shape
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return 0, width, 0, height
    margin = max(20, int(around * max(np.ptp(rows), np.ptp(columns))))
    left, right = max(0, int(columns[0]) - margin), min(width, int(columns[-1]) + margin + 1)
    top, bottom = max(0, int(rows[0]) - margin), min(height, int(rows[-1]) + margin + 1)
    return left, right, top, bottom


def _name(axes: Axes, name: str, inside: Bool, colour: str, ends: Float64 | None) -> None:
    """Write the id of an object on it; far from the closing line between the ends (2, 2) of a grasp on it."""
    places = np.argwhere(inside)[:, ::-1]
    place = np.median(places, axis=0)
    if ends is not None:
        along = ends[1] - ends[0]
        apart = (places - ends[0]) @ np.array([-along[1], along[0]])
        place = places[np.argmax(np.abs(apart))]
    _label(axes, name, place, (0.0, 0.0), colour)


def _label(axes: Axes, text: str, place: Any, shift: Any, colour: str) -> None:
    """Write a word at a place of a picture, shifted by some points."""
    axes.annotate(text, place, shift, textcoords="offset points", color="white", fontsize=TEXT_PT,
                  fontweight="bold", ha="center", va="center", zorder=6, annotation_clip=True,
                  bbox={"boxstyle": "round,pad=0.2", "facecolor": colour, "edgecolor": "white", "linewidth": 0.6})  # fmt: skip


def _draw_grasp(axes: Axes, cloud: Cloud, grasp: Grasp, fingers: Sequence[str]) -> None:
    """Draw the hand as the camera would see it, and the contacts with the names of their fingers and the closing line."""
    for part, boxes in hand_boxes(grasp).items():
        draw_boxes(axes, pixels_of(cloud, boxes[(boxes[..., 2] > 0.0).all(axis=1)]), part)  # in front of the camera
    ends = pixels_of(cloud, np.stack([grasp.g1, grasp.g2]))
    axes.plot(*ends.T, color="white", linewidth=3.2, zorder=5)
    axes.plot(*ends.T, color=INK, linewidth=1.6, zorder=5)
    away = (ends - ends.mean(axis=0)) * [1.0, -1.0]  # up in a picture is down in rows
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    for (u, v), colour, name, aside in zip(ends, FINGER_COLOURS, fingers, away, strict=False):
        axes.plot(u, v, "o", color=colour, markeredgecolor="white", markersize=7.5, zorder=5)
        _label(axes, name, np.array([u, v]), aside * [9.0 + 2.6 * len(name), 15.0], colour)
