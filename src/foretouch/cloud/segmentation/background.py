# SPDX-License-Identifier: Apache-2.0
"""What stands on the table, and what is background: a wall, a chair behind it, a robot that reaches over it (`kernels/background.c`).

An object rests on the table within its outline, or on something that does. The outline is the convex hull of the table in the
image, with its holes and the dents that things leave which hide it. Other parts are background, for a reason:

- `enters_view`: it comes from the image's border over the table, or is joined to what does. Fingers have to avoid it.
- `beyond_table`: it stands outside of the outline.
- `floating`: it touches neither the table nor an object in the image, and its points are all high.
- `wall`: it lies in the plane of a larger part beyond the table that it is joined to, or it is a side of a bin: a long upright sheet
  that meets another one, or has its height; all sides in one, with the table between them; or a piece of their rim.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from foretouch.cloud.segmentation.clusters import LOCAL_FACTOR, Clusters, CoarseGrid, HeightThreshold
from foretouch.kernels import Kernel, struct
from foretouch.types import Float64, Int64, UInt8

_find = Kernel("find_background")

ENTERS = "enters_view"
REASONS = ("", ENTERS, "beyond_table", "floating", "wall")
# Of the table, what is below it, a foot, and a wall [m]; and the share of an outline at the border of the image.
_LIMITS = {"level": 0.006, "below": 0.03, "foot": 0.03, "flat": 0.01, "border": 0.17}


class Background(NamedTuple):
    """What is background. Labels are counted on from one window to the next."""

    reasons: Int64  # (n,) the index in `REASONS` of each label; 0 for what stands on the table
    cut: UInt8  # (n,) whether the border of the image cuts it
    outline: Float64  # (m, 3) outline of the table [m], empty if it is not seen


def find_background(
    grid: CoarseGrid, windows: Sequence[Clusters], threshold: HeightThreshold, *, hidden: bool = False
) -> Background:
    """Find why parts are background, and which the image cuts.

    Args:
        grid: Coarse grid of the image.
        windows: Labelled windows of the image.
        threshold: The table, and the noise of the depth.
        hidden: The table is not seen: it has no outline, and nothing is background.
    """
    if hidden:
        count = 1 + sum(window.n_labels for window in windows)
        return Background(np.zeros(count, np.int64), np.zeros(count, np.uint8), np.empty((0, 3)))
    (h, w), plane = grid.points.shape[:2], threshold.plane.coefficients
    labels, count = np.zeros((h, w), np.int32), 1
    for window in windows:
        part = window.labels[:: grid.stride, :: grid.stride]
        at = np.s_[window.rows // grid.stride :, window.columns // grid.stride :]
        view = labels[at][: part.shape[0], : part.shape[1]]
        np.copyto(view, part + np.int32(count - 1), where=part > 0)
        count += window.n_labels
    background = Background(np.zeros(count, np.int64), np.zeros(count, np.uint8), np.empty((4 * h + 2, 3)))
    n_corners = np.empty(1, np.int64)
    image = {"grid": grid.points, "labels": labels, "h": h, "w": w, "n": count, "pitch": grid.pitch}
    _find(
        struct("Parts", **image, plane=plane, noise=LOCAL_FACTOR * threshold.local_per_m, **_LIMITS),
        background.reasons,
        background.cut,
        background.outline,
        n_corners,
    )
    if n_corners[0] < 0:
        raise MemoryError("find_background")
    return background._replace(outline=background.outline[: n_corners[0]])
