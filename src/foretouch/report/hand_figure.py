# SPDX-License-Identifier: Apache-2.0
"""The boxes of a described hand: as lines in space, and drawn from the side and from the front."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.grasp.hand import FINGER, PALM, THUMB, Hand, load_hand
from foretouch.report.panels import SMALL_PT, Axes, new_figure, save
from foretouch.types import Float64, Grasp

_EDGES: Final = [(a, b) for a in range(8) for b in (a ^ 1, a ^ 2, a ^ 4) if a < b]  # of the corners of a box
_SILHOUETTE, _MARGIN = 400, 8  # pixels of the longer side of a silhouette, and around it
_MORE_SEEN: Final = 1.02  # times the area that is seen, from which on an unseen side is drawn
COLOURS: Final = {FINGER: "#00798c", PALM: "#6f7780", THUMB: "#d1495b"}
"""Of the parts of a hand; thumb and finger have the colours of their contacts, g1 and g2."""


def hand_boxes(grasp: Grasp) -> dict[str, Float64]:
    """Find the boxes of a hand that has taken a grasp.

    Args:
        grasp: Of a plan.

    Returns:
        By part (`finger`, `palm`, `thumb`) the corners (B, 8, 3) float64 of B boxes [m], in the frame of the grasp's cloud. Empty for
        a grasp that was not planned for a hand, and for a hand without boxes.

    Raises:
        ConfigError: If the description of the hand is not found, as of a grasp from another computer.
    """
    if grasp.way is None:
        return {}
    hand = load_hand(grasp.way.hand)
    at = hand.at(grasp.width_m)
    pose = grasp.way.pose_of_hand @ np.linalg.inv(at.tool)
    corners = np.asarray(at.corners @ pose[:3, :3].T + pose[:3, 3], np.float64)
    parts = np.array(hand.parts)
    return {part: corners[parts == part] for part in COLOURS if part in hand.parts}


def finger_names(grasp: Grasp) -> tuple[str, str]:
    """Return what the fingers at g1 and g2 are called: of a hand with joints thumb and middle finger, else the contacts."""
    if grasp.way is None or not grasp.way.joints:
        return "g1", "g2"
    return ("middle finger", "thumb") if grasp.way.thumb_at == "g2" else ("thumb", "middle finger")


def hand_lines(grasp: Grasp) -> dict[str, Float64]:
    """Find the edges of `hand_boxes`: by part the ends (E, 2, 3) float64 of E edges [m]."""
    return {part: boxes[:, _EDGES].reshape(-1, 2, 3) for part, boxes in hand_boxes(grasp).items()}


def draw_boxes(axes: Axes, boxes: Float64, part: str) -> None:
    """Draw the silhouette of boxes of a part of the hand, whose corners (B, 8, 2) lie in the plane of a picture; the picture shows through."""
    from PIL import Image, ImageDraw
    from scipy.ndimage import gaussian_filter
    from scipy.spatial import ConvexHull

    if not boxes.size:
        return
    low, span = boxes.min(axis=(0, 1)), float(np.ptp(boxes, axis=(0, 1)).max())
    step = span / (_SILHOUETTE - 2 * _MARGIN)
    image = Image.new("L", (_SILHOUETTE, _SILHOUETTE))
    for corners in boxes:
        outline = (corners[ConvexHull(corners).vertices] - low) / step + _MARGIN
        ImageDraw.Draw(image).polygon(list(map(tuple, outline)), fill=1)
    inside = gaussian_filter(np.asarray(image, np.float64), _MARGIN / 4.0)
    x, y = low[:, None] + step * (np.arange(_SILHOUETTE) - _MARGIN)
    fill, alpha, zorder = ("#e3e7eb", 0.45, 3.5) if part == PALM else (COLOURS[part], 0.6, 4.0)
    axes.contourf(x, y, inside, levels=[0.5, 2.0], colors=fill, alpha=alpha, zorder=zorder)
    axes.contour(x, y, inside, levels=[0.5], colors=COLOURS[part], linewidths=1.2, zorder=zorder)


def draw_unseen(axes: Axes, seen: Float64, unseen: Float64) -> None:
    """Hatch the outline of points (N, 2) that no camera saw, with a legend, where they reach beyond those (M, 2) that were seen."""
    from scipy.spatial import ConvexHull, QhullError

    with suppress(QhullError, ValueError):  # of too few points, or of a line
        area, both = (ConvexHull(points).volume for points in (seen, np.concatenate([seen, unseen])))
        if both > _MORE_SEEN * area:
            outline = unseen[ConvexHull(unseen).vertices].T
            axes.fill(*outline, fill=False, hatch="////", edgecolor="#b0b0b0", linewidth=0.8, linestyle="--", zorder=0.5, label="not seen")  # fmt: skip
            axes.legend(loc="upper right", fontsize=SMALL_PT, framealpha=0.8)


def save_hand_figure(hand: Hand, path: Path) -> Path:
    """Draw the boxes of a hand at three of its widths, seen across the fingers and along the line; returns the path, errors as `save`."""
    opening = hand.config.opening_m
    widths = [opening * share for share in (0.2, 0.6, 1.0)]
    figure = new_figure(4.0 * len(widths), 7.5)
    for number, width in enumerate(widths):
        at, open_ = hand.at(width), hand.opened(width)
        for row, (right, name) in enumerate(((0, "along the line, thumb to the right"), (1, "across the fingers"))):
            axes = figure.add_subplot(2, len(widths), row * len(widths) + number + 1)
            for part, closed, opened in zip(hand.parts, at.corners, open_, strict=True):
                for corners, style, wide in ((opened, ":", 0.6), (closed, "-", 1.1)):
                    lines = 1e3 * corners[_EDGES]
                    axes.plot(lines[..., right].T, -lines[..., 2].T, style, color=COLOURS[part], linewidth=wide)
            axes.plot(*([[-500.0 * width, 500.0 * width], [0.0, 0.0]] if row == 0 else [[0.0], [0.0]]), "k.-")
            depth = f", free {1e3 * at.depth_m:.0f} mm" if hand.limits_depth else ""
            axes.set(title=f"{1e3 * width:.0f} mm{depth}", xlabel=f"{name} [mm]", ylabel="towards the palm [mm]", aspect="equal")  # fmt: skip
    figure.suptitle(f"{hand.config.name}: {hand.config.summary}. Dotted: opened")
    return save(figure, path)


def save_surface_figure(
    hand: Hand, width_m: float, points: Mapping[str, Float64], outside_m: Mapping[str, Float64], path: Path
) -> Path:
    """Draw the boxes of a hand at a width over points of its real surface; returns the path, errors as `save`.

    Args:
        hand: The description.
        width_m: Width of the grasp [m].
        points: (N, 3) float64 points [m] of each link, in the frame of the grasp.
        outside_m: (N,) float64, how far they are outside of all boxes [m].
        path: The picture.
    """
    figure = new_figure(12.0, 6.5)
    xyz, away = (1e3 * np.concatenate(list(values.values())) for values in (points, outside_m))
    order = np.argsort(away, kind="stable")  # those outside are drawn last
    corners, marks = hand.at(width_m).corners, []
    for number, (right, name) in enumerate(((0, "along the line, thumb to the right"), (1, "across the fingers"))):
        axes = figure.add_subplot(1, 2, number + 1)
        shown = axes.scatter(
            xyz[order, right],
            -xyz[order, 2],
            c=away[order],
            s=2.0,
            cmap="plasma_r",
            vmin=0.0,
            vmax=max(5.0, away.max()),
        )
        marks.append(shown)
        for part, box in zip(hand.parts, corners, strict=True):
            lines = 1e3 * box[_EDGES]
            axes.plot(lines[..., right].T, -lines[..., 2].T, color=COLOURS[part], linewidth=1.0)
        axes.set(xlabel=f"{name} [mm]", ylabel="towards the palm [mm]", aspect="equal")
    figure.colorbar(marks[0], ax=figure.axes, label="outside of the boxes [mm]", shrink=0.7)
    figure.suptitle(f"{hand.config.name} at a width of {1e3 * width_m:g} mm, over {len(points)} links of the real hand")
    return save(figure, path)
