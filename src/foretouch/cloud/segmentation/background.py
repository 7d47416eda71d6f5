# SPDX-License-Identifier: Apache-2.0
"""What stands on the table, and what is background: a wall, a chair behind it, a robot that reaches over it (`kernels/background.c`).

An object rests on the table within its outline, or on something that does. The outline is the convex hull of the table in the
image, with its holes and the dents that things leave which hide it. Other parts are background, for a reason:

- `enters_view`: it comes from the image's border over the table, or is joined to what does. Fingers have to avoid it.
- `beyond_table`: it stands outside of the outline.
- `floating`: it touches neither the table nor an object in the image, and its points are all high.
- `wall`: it lies in the plane of a part beyond the table that it is joined to.
"""

from collections.abc import Sequence

import numpy as np

from foretouch.cloud.segmentation.clusters import Clusters, HeightThreshold
from foretouch.kernels import Kernel
from foretouch.types import Float32, Float64, Int64

_find = Kernel("find_background")

ENTERS = "enters_view"
REASONS = ("", ENTERS, "beyond_table", "floating", "wall")
_LEVEL_M, _BELOW_M, _FOOT_M, _FLAT_M = 0.006, 0.03, 0.03, 0.01  # of the table, what is below it, a foot, and a wall
_BORDER = 0.17  # share of a part's outline at the border of the image, from which on most of it may be out of view


def find_background(
    coarse: Float32, stride: int, windows: Sequence[Clusters], threshold: HeightThreshold, pitch: float
) -> tuple[list[Int64], Float64]:
    """Find why parts are background.

    Args:
        coarse: (h, w, 3) float32 [m], every `stride`-th point of the image.
        stride: Step of the coarse grid [px].
        windows: Labelled windows of the image.
        threshold: The table, and the noise of the depth.
        pitch: Lateral distance of neighbouring cells of the grid per depth.

    Returns:
        The index in `REASONS` of each label of each window, and the (n, 3) outline of the table [m], empty if it is not seen.
    """
    labels, count = np.zeros(coarse.shape[:2], np.int32), 1
    for window in windows:
        part = window.labels[::stride, ::stride]
        at = np.s_[window.rows // stride :, window.columns // stride :]
        view = labels[at][: part.shape[0], : part.shape[1]]
        np.copyto(view, part + np.int32(count - 1), where=part > 0)
        count += window.n_labels
    reasons = np.zeros(count, np.int64)
    outline = np.empty((4 * len(coarse) + 2, 2), np.float32)
    n_corners = np.empty(1, np.int64)
    plane = threshold.plane
    settings = [*plane.coefficients, _LEVEL_M, threshold.noise_per_m, _BELOW_M, _BORDER, _FOOT_M, _FLAT_M]
    _find(coarse, *labels.shape, labels, count, pitch, np.array(settings), reasons, outline, n_corners)
    if n_corners[0] < 0:
        raise MemoryError("find_background")
    rays = np.append(outline[: n_corners[0]].astype(np.float64), np.ones((n_corners[0], 1)), axis=1)
    ends = np.cumsum([window.n_labels for window in windows], dtype=np.int64)
    parts = [np.append(0, some) for some in np.split(reasons[1:], ends[:-1])]
    return parts, rays * (-plane.offset / (rays @ plane.normal))[:, None]
