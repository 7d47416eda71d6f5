# SPDX-License-Identifier: Apache-2.0
"""Data types shared by all packages: clouds, planes, grasps, tactile readings.

All are frozen; the numbers in their arrays are not, and copies of columns may share them. Lengths are in metres, stamps in integer nanoseconds, tactile values in the unit of the sensor. Clouds and
everything derived from them are in the camera's optical frame (x right, y down, z forward) unless `frame_id` differs.
"""

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
from foretouch.types.samples import APPROACH, DISCARDED, HOLD, OUTCOMES, REST, Outcome, Sample, TouchSeries

__all__ = [
    "APPROACH",
    "ASSUMED_TABLE",
    "DISCARDED",
    "HOLD",
    "LATE",
    "NO_CLOUD",
    "NO_GRASP",
    "NO_GRASPS",
    "OUTCOMES",
    "REST",
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
    "Outcome",
    "Plane",
    "Predicted",
    "Prediction",
    "Predictions",
    "Reference",
    "Rows",
    "Sample",
    "Touch",
    "TouchSeries",
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
