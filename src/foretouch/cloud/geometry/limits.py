# SPDX-License-Identifier: Apache-2.0
"""Refuse objects and tables that a depth camera cannot see and a hand cannot hold."""

import math
from dataclasses import dataclass

import numpy as np

from foretouch.cloud.geometry.columns import bounds
from foretouch.cloud.geometry.frames import TANGENT, not_optical
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, FrameError, LimitError
from foretouch.types import Float32, Plane


@dataclass(frozen=True, kw_only=True)
class ObjectLimits(Settings):
    """Where an object can be, and how large. By default, of a D415 and a Shadow Hand."""

    min_range_m: float = setting(0.16, "Objects whose centre is nearer to the camera are refused", bounds=(0.0, 10.0))
    max_range_m: float = setting(10.0, "Objects and tables farther from the camera are refused", bounds=(0.1, 100.0))
    min_extent_m: float = setting(0.005, "Objects whose largest side is shorter are refused", bounds=(1e-6, 1.0))
    max_extent_m: float = setting(0.6, "Objects whose largest side is longer are refused", bounds=(0.01, 10.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        for low, high in (("min_range_m", "max_range_m"), ("min_extent_m", "max_extent_m")):
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError(f"{low}: {getattr(self, low)} is not below {high} {getattr(self, high)}")


DEFAULT_LIMITS = ObjectLimits()

_BELOW_M = 0.01  # by which a flat object may be below its table, which is estimated


def check_object(xyz: Float32, limits: ObjectLimits = DEFAULT_LIMITS) -> None:
    """Check range, size and frame of an object.

    Args:
        xyz: (..., 3) float32 [m], its points, the sensor at the origin. Points that are not finite are ignored;
            without two different points nothing is checked.
        limits: Range and size; with a `min_range_m` of 0 the points may be in any frame.

    Raises:
        LimitError: Names the measure and its limit.
        FrameError: If the points are not in the optical frame of a camera that can have seen them.
    """
    low, high = bounds(np.asarray(xyz.reshape(-1, 3), np.float32))
    extent = float((high - low).max())
    if extent in (0.0, -math.inf):
        return
    distance = math.hypot(*((low + high) / 2.0).tolist())
    away, long = f"xyz: the object is {distance:.4g} m away", f"xyz: the object extends {extent:.4g} m"
    scene = "; a list of the points of a whole scene is segmented with --scene, an image without --plane"
    frame = "for a cloud in the object's own frame set limits.min_range_m=0"
    for broken, reason in (
        (distance > limits.max_range_m, f"{away}, more than max_range_m {limits.max_range_m:g}{_unit(distance)}"),
        (
            extent > limits.max_extent_m,
            f"{long}, more than max_extent_m {limits.max_extent_m:g}{_unit(extent) or scene}",
        ),
        (extent < limits.min_extent_m, f"{long}, less than min_extent_m {limits.min_extent_m:g}"),
        (distance < limits.min_range_m, f"{away}, less than min_range_m {limits.min_range_m:g}; {frame}"),
    ):
        if broken:
            raise LimitError(reason)
    seen = low[2] > 0.0 and max(abs(float(end)) for end in (*low[:2], *high[:2])) <= TANGENT * low[2]
    if not seen and limits.min_range_m > 0.0 and (fault := not_optical(xyz, alone=True)):
        raise FrameError(fault)


def _unit(length: float) -> str:
    """Return a question that is added to the refusal of a length that is likely in millimetres."""
    return "; is it in metres? Multiply millimetres by 0.001" if abs(length) > 10.0 else ""


def check_table(plane: Plane, limits: ObjectLimits = DEFAULT_LIMITS, xyz: Float32 | None = None) -> None:
    """Check that a table is in front of the camera, which is at the origin and looks along z, and carries its object.

    Args:
        plane: The table; one through the camera itself is accepted.
        limits: Range; with a `min_range_m` of 0 the cloud may be in any frame, and the table on any side.
        xyz: (..., 3) float32 [m], points of the object, if there is one. Points that are not finite are ignored.

    Raises:
        LimitError: If it is behind the camera, out of range, or all of the object is below it or far above it.
    """
    if not abs(plane.offset) <= limits.max_range_m:
        raise LimitError(
            f"plane: is {abs(plane.offset):.4g} m away, more than max_range_m {limits.max_range_m:g}{_unit(plane.offset)}"
        )
    if limits.min_range_m == 0.0:  # the cloud may be in the object's own frame, without a camera
        return
    x, y, z = plane.normal.tolist()
    sideways = TANGENT * (abs(x) + abs(y))
    # n·p + d = 0 has no solution p = t (u, v, 1) with t > 0 in the field of view.
    if (plane.offset > 0.0 and z - sideways >= 0.0) or (plane.offset < 0.0 and z + sideways <= 0.0):
        raise LimitError(f"plane: {plane.coefficients.tolist()} is behind the camera")
    if xyz is None or abs(plane.offset) <= _BELOW_M:
        return
    heights = plane.towards_camera.height(xyz.reshape(-1, 3))
    heights = heights[np.isfinite(heights)]
    if not heights.size:
        return
    low, high = float(heights.min()), float(heights.max())
    if low > limits.max_extent_m or high < -_BELOW_M:
        where = f"{low:.3g} m above" if low > 0.0 else f"{-high:.3g} m below"
        raise LimitError(f"plane: all of the object is {where} it; is it the table, in the frame of the cloud?")
