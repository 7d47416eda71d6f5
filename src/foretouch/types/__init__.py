# SPDX-License-Identifier: Apache-2.0
"""Data types shared by all packages: clouds, planes, grasps, tactile readings.

All are frozen. Lengths are in metres, stamps in integer nanoseconds, tactile values in the unit of the sensor. Clouds and
everything derived from them are in the camera's optical frame (x right, y down, z forward) unless `frame_id` differs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt

from foretouch.errors import CloudError
from foretouch.types.arrays import (
    AnyArray,
    Bool,
    Columns,
    Float32,
    Float64,
    Floating,
    Index,
    Int32,
    Int64,
    Integer,
    Objects,
    Rows,
    UInt8,
)
from foretouch.types.grasps import NO_GRASP, NO_GRASPS, Grasp, Grasps
from foretouch.types.predictions import (
    LATE,
    REDUCED,
    UNKNOWN_FRAME,
    Evidence,
    Predicted,
    Prediction,
    Predictions,
    Reference,
    Touch,
)

__all__ = [
    "ASSUMED_TABLE",
    "LATE",
    "NO_CLOUD",
    "NO_GRASP",
    "NO_GRASPS",
    "REDUCED",
    "SECOND_NS",
    "SQUARABLE",
    "UNKNOWN_FRAME",
    "AnyArray",
    "Bool",
    "Cloud",
    "Columns",
    "Evidence",
    "Float32",
    "Float64",
    "Floating",
    "Grasp",
    "GraspSample",
    "Grasps",
    "Index",
    "Int32",
    "Int64",
    "Integer",
    "Objects",
    "Plane",
    "Predicted",
    "Prediction",
    "Predictions",
    "Reference",
    "Rows",
    "Touch",
    "UInt8",
    "assumed_table",
]

SECOND_NS = 1_000_000_000
"""Nanoseconds in a second."""

SQUARABLE = (1e-145, 1e150)
"""Numbers between these have squares of full precision.

A vector with a larger or smaller one is scaled before its norm.
"""


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud, organised like an image or not.

    Raises:
        CloudError: If a shape or a dtype is wrong.
    """

    xyz: Float32  # (N, 3) or organised (H, W, 3), float32 [m]. All three are NaN for a pixel without depth
    rgb: UInt8 | None = None  # the same shape, uint8, or None
    frame_id: str = ""  # the frame of `xyz`
    stamp_ns: int = 0  # time of measurement [ns]

    def __post_init__(self) -> None:
        if self.xyz.ndim not in (2, 3) or self.xyz.shape[-1] != 3:
            raise CloudError(f"xyz: shape {self.xyz.shape} is neither (N, 3) nor (H, W, 3)")
        if self.xyz.dtype != np.float32:
            raise CloudError(f"xyz: dtype {self.xyz.dtype} is not float32")
        if self.rgb is not None:
            if self.rgb.shape != self.xyz.shape:
                raise CloudError(f"rgb: shape {self.rgb.shape} is not that of xyz, {self.xyz.shape}")
            if self.rgb.dtype != np.uint8:
                raise CloudError(f"rgb: dtype {self.rgb.dtype} is not uint8")

    @property
    def organised(self) -> bool:
        """Whether the points form an image."""
        return self.xyz.ndim == 3

    @property
    def size(self) -> int:
        """Number of points, including those without depth."""
        return self.xyz.size // 3

    def take(self, index: Index | Bool) -> "Cloud":
        """Selected points as an unorganised cloud, by flat indices or by a mask (N,) or (H, W)."""
        flat = np.flatnonzero(index) if index.dtype == np.bool_ else index
        rgb = None if self.rgb is None else self.rgb.reshape(-1, 3).take(flat, axis=0)
        # take() is four times as fast as indexing here.
        return Cloud(self.xyz.reshape(-1, 3).take(flat, axis=0), rgb, self.frame_id, self.stamp_ns)


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane n·p + d = 0."""

    normal: Float64  # (3,) float64, unit length, towards the camera if the plane was measured
    offset: float  # d [m]

    @classmethod
    def from_coefficients(cls, coefficients: npt.ArrayLike) -> Self:
        """A plane from (a, b, c, d) of any scale.

        A `CloudError` if they or the offset are not finite or (a, b, c) is zero.
        """
        abcd = np.asarray(coefficients, dtype=np.float64)
        if abcd.shape != (4,) or not np.isfinite(abcd).all():
            raise CloudError(f"plane: {coefficients!r} is not four finite numbers")
        largest = float(np.abs(abcd[:3]).max())
        if largest == 0.0:
            raise CloudError("plane: the normal has zero length")
        with np.errstate(over="ignore"):
            if not SQUARABLE[0] < largest < SQUARABLE[1]:
                abcd = abcd / largest
            abcd = abcd / float(np.linalg.norm(abcd[:3]))
        if not np.isfinite(abcd[3]):
            raise CloudError(f"plane: the offset of {coefficients!r} is not finite")
        return cls(abcd[:3], float(abcd[3]))

    @property
    def coefficients(self) -> Float64:
        """(4,) float64: a, b, c, d."""
        return np.append(self.normal, self.offset)

    def height(self, xyz: Floating) -> Floating:
        """Signed distance of points (..., 3) from the plane [m], positive on the normal's side."""
        return xyz @ self.normal.astype(xyz.dtype) + xyz.dtype.type(self.offset)


ASSUMED_TABLE = Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])
"""The table of a cloud that holds only an object: seen from straight above, as in the public recordings."""


def assumed_table(cloud: Cloud) -> Plane:
    """The table of a cloud that holds only an object: as `ASSUMED_TABLE`, but through the farthest point."""
    depths = cloud.xyz[..., 2]
    depths = depths[np.isfinite(depths)]
    return Plane(ASSUMED_TABLE.normal, -float(depths.max())) if depths.size else ASSUMED_TABLE


NO_CLOUD = Cloud(np.empty((0, 3), np.float32))
"""The cloud of a sample that was recorded without a camera: it has no points, and the sample's grasp is not known."""


@dataclass(frozen=True, eq=False)
class GraspSample:
    """One grasp of the dataset (P2: <C, g1, g2, R, PDC_TH, PDC_MF, E_TH, E_MF>)."""

    id: str  # `<object>/<source id>`
    object: str  # label of the object
    # By factories, since subclasses read their cloud when it is asked for, and must not find a default in the class.
    cloud: Cloud = field(default_factory=lambda: NO_CLOUD)  # the object's cloud on which the grasp was planned
    grasp: Grasp = field(default_factory=lambda: NO_GRASP)
    touch: Touch | None = None  # reading in contact; None for an unlabelled sample
    tare: Touch | None = None  # reading without contact; None if there is none
    stamp_ns: int = 0  # time of recording [ns]
    extra: Mapping[str, float] = field(default_factory=dict)  # further values of the source, by name
