# SPDX-License-Identifier: Apache-2.0
"""Ids of objects, a grasp and its hand, drawn into the small image that the graph publishes; without Matplotlib, which is too slow for it."""

import functools
from typing import Any, Final

import numpy as np

from foretouch.report.camera_figure import pixels_of
from foretouch.report.hand_figure import COLOURS, hand_boxes
from foretouch.report.panels import FINGER_COLOURS
from foretouch.types import Float64, Grasp, UInt8
from foretouch.types.scene import Scene

_DOT_PX: Final = 4.0  # radius of a contact


def marked(image: UInt8, scene: Scene, step: int, grasp: Grasp | None) -> UInt8:
    """Draw ids and a grasp over an image.

    Args:
        image: (h, w, 3) uint8, every `step`th row and column of the scene's image.
        scene: Its objects get their ids.
        step: Pixels of the scene for a pixel of the image.
        grasp: Is drawn with its contacts and the boxes of its hand; None for none.

    Returns:
        (h, w, 3) uint8, another image.
    """
    from PIL import Image, ImageDraw

    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture)
    if grasp is not None and scene.cloud.organised:
        _draw_grasp(draw, scene, step, grasp)
    width = scene.labels.shape[-1]
    for one in scene.objects:
        if len(one.pixels):
            row, column = (float(np.median(places)) / step for places in np.divmod(one.pixels, width))
            style: dict[str, Any] = {"fill": "white", "stroke_width": 2, "stroke_fill": "black", "anchor": "mm"}
            draw.text((column, row), one.id, font=_font(), **style)
    return np.array(picture)


@functools.cache
def _font() -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(14)


def _draw_grasp(draw: Any, scene: Scene, step: int, grasp: Grasp) -> None:
    """Draw the outlines of the hand's boxes, the closing line and both contacts."""
    from scipy.spatial import ConvexHull

    boxes = [(part, box) for part, found in hand_boxes(grasp).items() for box in found if box[:, 2].min() > 0.0]
    points = np.concatenate([grasp.g1[None], grasp.g2[None], *(box for _, box in boxes)])  # in front of the camera
    flat: Float64 = pixels_of(scene.cloud, points) / step
    for (part, _), corners in zip(boxes, flat[2:].reshape(-1, 8, 2), strict=True):
        draw.polygon([tuple(corners[k]) for k in ConvexHull(corners).vertices], outline=COLOURS[part])
    ends = [(float(u), float(v)) for u, v in flat[:2]]
    draw.line(ends, fill="white", width=2)
    for (u, v), colour in zip(ends, FINGER_COLOURS, strict=False):
        draw.ellipse((u - _DOT_PX, v - _DOT_PX, u + _DOT_PX, v + _DOT_PX), fill=colour, outline="white")
