# SPDX-License-Identifier: Apache-2.0
"""Where an object ends along a line, by its image.

A point is the middle of a pixel, so an object ends half a pixel beyond the last one of its outline. Pixels on an edge of depth mix both sides, and are
dropped as flying ones: where the next pixels are neither the object nor the background, the object ends in the middle of them. A side that faces the
camera ends where its surface is.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from foretouch.grasp.preprocessing import FinitePoints
from foretouch.grasp.unseen import BEHIND_M, DepthAround
from foretouch.kernels import Kernel
from foretouch.types import Bool, Float32, Float64

_outline_ends = Kernel("outline_ends")

_BESIDE_M = 0.006  # of a line, up to where the outline counts, with falling weight
_STEEP = 2.0  # slope of a surface against the image, from which on its depth counts as an edge


@dataclass(frozen=True, eq=False)
class SeenOutline:
    """All points of an object, none left out, and the depth image around it."""

    xyz: Float32  # (N, 3) float32 [m], finite, camera frame
    own: Bool  # (H, W) bool, its pixels
    around: DepthAround

    @classmethod
    def of(cls, points: FinitePoints, around: DepthAround | None) -> Self | None:
        """Keep the points of an object with their pixels; None where the image is not known.

        Args:
            points: All of them.
            around: The depth image around the object.
        """
        if around is None or points.pixels is None or points.image_shape is None:
            return None
        own = np.zeros(points.image_shape, np.bool_)
        own.reshape(-1)[points.pixels] = True
        return cls(points.xyz, own, around)

    def ends(self, axes: Float64, origin: Float64, tip_radius_m: float) -> tuple[Float64, Float64]:
        """Find where the object ends on either side along a line, by rows that are one pixel wide.

        Args:
            axes: (3, 3) float64, rows of unit length: along the line, beside it, and up; camera frame.
            origin: (3,) float64, a place on the line [m], camera frame.
            tip_radius_m: Of a fingertip, which touches what is higher than this below the line.

        Returns:
            (2,) float64 [m], from the origin along the line, the lower end first, NaN without a point; and (2,) float64, the share of the rows
            that end on the outline. The others face the camera.
        """
        pixel_m = self.around.pixel_m(float(origin[2]))
        rows = int(2.0 * _BESIDE_M / pixel_m) + 1
        frame = np.concatenate([axes.reshape(-1), origin])
        settings = np.array([_BESIDE_M, tip_radius_m, pixel_m, BEHIND_M, _STEEP])
        found, ends = np.empty((4, 2, rows)), np.empty((2, 2))
        own, image = self.own.view(np.uint8), self.around.c_image
        _outline_ends(self.xyz, len(self.xyz), own, image, frame, settings, rows, found, ends)
        return ends[0], ends[1]
