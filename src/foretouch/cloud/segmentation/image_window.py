# SPDX-License-Identifier: Apache-2.0
"""A part of an organised cloud around something that stands on the table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from foretouch.cloud.segmentation.clusters import ClusterConfig, HeightCut
from foretouch.types import Float32

__all__ = ["ImageWindow"]

Bool = npt.NDArray[np.bool_]


class ImageWindow(NamedTuple):
    """A part of the image, its upper left corner on the coarse grid.

    Attributes:
        z: (h, w) float32 [m].
        height: (h, w) float32, above the table [m].
        above: (h, w) bool, in range and standing out from the table.
        cut: What is table.
        stride: Of the coarse grid [px].
        pitch: Lateral distance of neighbouring pixels per depth.
        config: What is one object.
    """

    z: Float32
    height: Float32
    above: Bool
    cut: HeightCut
    stride: int
    pitch: float
    config: ClusterConfig

    @property
    def grid(self) -> tuple[slice, slice]:
        """The pixels of the coarse grid."""
        return (slice(None, None, self.stride), slice(None, None, self.stride))

    def reach(self, z: Float32) -> Float32:
        """Depth by which connected neighbours of a pixel may differ [m]."""
        return self._step(z, self.config.max_slope)

    def near(self, z: Float32) -> Float32:
        """Depth by which neighbours that support a pixel may differ [m]."""
        return self._step(z, self.config.flying_slope)

    def _step(self, z: Float32, slope: float) -> Float32:
        step: Float32 = np.maximum(z * np.float32(slope * self.pitch), np.float32(self.config.gap_m))
        return step
