# SPDX-License-Identifier: Apache-2.0
"""Data types shared by all packages: clouds, planes, grasps, tactile readings.

All are frozen. Lengths are in metres, stamps in integer nanoseconds, tactile values in the unit of the sensor. Clouds and
everything derived from them are in the camera's optical frame (x right, y down, z forward) unless `frame_id` differs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

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
from foretouch.types.camera import CameraModel
from foretouch.types.cloud import ASSUMED_TABLE, NO_CLOUD, SQUARABLE, Cloud, Plane, assumed_table
from foretouch.types.grasps import NO_GRASP, NO_GRASPS, Grasp, Grasps, WayIn
from foretouch.types.predictions import (
    LATE,
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
    "SECOND_NS",
    "SQUARABLE",
    "UNKNOWN_FRAME",
    "AnyArray",
    "Bool",
    "CameraModel",
    "Cloud",
    "Columns",
    "Evidence",
    "Float32",
    "Float64",
    "Floating",
    "Grasp",
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
    "Sample",
    "Touch",
    "UInt8",
    "WayIn",
    "assumed_table",
    "stamp_ns",
]

SECOND_NS = 1_000_000_000
"""Nanoseconds in a second."""


def stamp_ns(stamp: Any) -> int:
    """Convert a `builtin_interfaces/Time` or `Duration` to whole nanoseconds."""
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)


@dataclass(frozen=True, eq=False)
class Sample:
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
