# SPDX-License-Identifier: Apache-2.0
"""Label the objects of an organised cloud by connected components in the image.

Points above the table are first labelled on a coarse grid of pixels. Two neighbours of the grid are connected unless
the pixels between them fall to the table or jump in depth, so that an object in front of another one is not merged
with it. The labels then grow to full resolution, and the outlines are refined:

- Flying pixels lie in the air between an object and its background, since the camera mixed both. They have few
  neighbours at their own depth. Those next to solid pixels of the object are its outline: they keep its label, but
  their depth belongs to neither surface, hence they are not solid.
- Base pixels are below the height threshold, touch an object and lie at its depth: they are the foot of the object.
"""

import numpy as np

from foretouch.cloud.segmentation.clusters import ClusterConfig, Clusters, HeightThreshold
from foretouch.cloud.segmentation.crop import CropConfig
from foretouch.cloud.segmentation.rays import RayFilter
from foretouch.kernels import Kernel
from foretouch.types import Float32

_grid_patches = Kernel("grid_patches", *(np.float32, int, int, int, int, np.float64, np.int32, np.int64, np.int64))
_label_window = Kernel(
    "label_window",
    *(np.float32, int, int, int, int, int, np.int32, int, int, int, int),
    *(np.float64, int, int, int, np.uint8, np.int32, np.uint8, np.int64),
)


def label_organised(
    xyz: Float32,
    coarse: Float32,
    stride: int,
    crop: CropConfig,
    threshold: HeightThreshold,
    config: ClusterConfig,
    rays: RayFilter | None = None,
) -> list[Clusters]:
    """Label an organised cloud.

    Args:
        xyz: (H, W, 3) float32 [m], contiguous, camera optical frame.
        coarse: Every `stride`-th of its rows and columns, contiguous.
        stride: Step of the coarse grid [px].
        crop: Depth range.
        threshold: Height threshold above the table.
        config: Settings.
        rays: Drops and counts points beside the ray of their pixel, if given.

    Returns:
        Labelled windows of the image, one around each patch above the table. The rectangles may overlap, but
        no pixel has a label in two of them. Small clusters are not yet removed.
    """
    image, grid = xyz.shape[:2], coarse.shape[:2]
    # The smallest number of pixels of the coarse grid that may belong to an object.
    min_nodes, pitch = max(1, config.min_points // (2 * stride * stride)), _pixel_pitch(coarse) / stride
    settings = np.array(
        [
            *threshold.plane.coefficients,
            *(threshold.low_m, threshold.noise_per_m, threshold.high_m, crop.min_range_m, crop.max_range_m),
            *(config.max_slope * pitch, config.flying_slope * pitch, config.gap_m, config.min_top_m),
            *([0.0] * 8 if rays is None else [1.0, *rays.numbers]),
        ]
    )
    patches, found = np.empty(grid, np.int32), np.empty(2, np.int64)
    boxes = np.empty((patches.size // min_nodes + 1, 4), np.int64)
    _grid_patches(coarse, *grid, stride, min_nodes, settings, patches, boxes, found)
    if found[0] < 0:
        raise MemoryError("grid_patches")
    if found[1] and rays is not None:
        rows, columns = np.nonzero(patches < 0)
        rays.record(stride * (rows * image[1] + columns))
    spans = boxes[: found[0]] + np.array([-1, 1, -1, 1])  # a margin of one cell
    spans = np.minimum(np.maximum(spans, 0) * stride, (image[0], image[0], image[1], image[1]))
    low, high = spans.min(axis=0, initial=max(image)), spans.max(axis=0, initial=0)
    marks = np.zeros((max(0, high[1] - low[0]), max(0, high[3] - low[2])), np.uint8)
    marked = (int(low[0]), int(low[2]), marks.shape[1], marks)
    windows: list[Clusters] = []
    any_beside = False
    for number, (top, bottom, left, right) in enumerate(spans.tolist(), 1):
        labels, solid = (
            np.empty((bottom - top, right - left), np.int32),
            np.empty((bottom - top, right - left), np.uint8),
        )
        rest = (grid[1], stride, number, min_nodes, settings, *marked, labels, solid, found)
        _label_window(xyz, image[1], top, left, *labels.shape, patches, *rest)
        if found[0] < 0:
            raise MemoryError("label_window")
        any_beside |= found[1] > 0
        windows.append(Clusters(labels, solid.view(np.bool_), int(found[0]), top, left))
    if any_beside and rays is not None:
        rows, columns = np.nonzero(marks & 2)
        rays.record((rows + low[0]) * image[1] + columns + low[2])
    return windows


def _pixel_pitch(xyz: Float32) -> float:
    """Lateral distance of horizontal neighbours per depth: 1/f of a pinhole camera; 0 if there are none."""
    rows = xyz[:: max(1, len(xyz) // 4)]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ray = rows[..., 0] / rows[..., 2]
        steps = np.abs(np.diff(ray, axis=1))
    steps = steps[np.isfinite(steps)]
    if not steps.size:
        return 0.0
    middle = [(steps.size - 1) // 2, steps.size // 2]
    low, high = np.partition(steps, middle)[middle]  # a third of the time of np.median
    return float((low + high) / np.float32(2.0))
