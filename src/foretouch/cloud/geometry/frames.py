# SPDX-License-Identifier: Apache-2.0
"""Recognise points that were measured, and clouds that are not in the optical frame of their camera: x right, y down, z away from it."""

import math
from typing import Final

import numpy as np

from foretouch.types import Bool, Float32

FIELD_OF_VIEW_DEG: Final = 120.0  # across and down, at most; a D415 has 65 x 40 degrees, the widest RealSense 90
TANGENT: Final = math.tan(math.radians(FIELD_OF_VIEW_DEG) / 2.0)  # the largest |x/z| and |y/z| in it
_CHECKED = 1024  # points of a cloud
_FARTHEST_M = 100.0  # no camera measures farther
_FORWARD = 0.9  # share of points in view along x in the frame of a link
_HALF = 0.5


def not_optical(xyz: Float32, *, alone: bool = False) -> str:
    """Explain why a cloud is not in the optical frame of its camera.

    Args:
        xyz: (..., 3) float32 [m]; points that are not finite, or all zero, are left out.
        alone: Whether the points are of one object. If most are out of view, that object was seen by no camera at the
            origin; of a scene, they may be damaged.

    Returns:
        A reason that begins with `not_optical` if most points are at z <= 0, or if most are out of view and they are an
        object, or nearly all in view along x, as in the frame of a camera's link. "" if the cloud may be in that frame.
    """
    points = xyz.reshape(-1, 3)
    columns = points[:: max(1, len(points) // _CHECKED)].T.astype(np.float64, order="C")  # rows of three are slow
    size = np.abs(columns).max(axis=0, initial=0.0)
    columns = columns[:, (size > 0.0) & (size < np.inf)]
    x, y, z = columns
    hidden = 1.0 - _share((z > 0.0) & (np.maximum(np.abs(x), np.abs(y)) <= TANGENT * z))
    if hidden <= _HALF:
        return ""
    behind = _share(z <= 0.0)
    forward = _share((x > 0.0) & (x < _FARTHEST_M) & (np.maximum(np.abs(y), np.abs(z)) <= TANGENT * x))
    along_x = ", but in view along x, as in the frame of a link" if forward >= _FORWARD else ""
    if behind > _HALF:
        what = f"{behind:.0%} of the points are at z <= 0, behind the camera{along_x}"
    elif along_x or alone:
        what = f"{hidden:.0%} of the points are out of view along z{along_x}"
    else:
        return ""
    rule = "an optical frame (x right, y down, z forward) is needed"
    return f"not_optical: {what}: {rule}; transform the points to the frame of the camera that saw them"


def has_depth(xyz: Float32) -> Bool:
    """Find the points that were measured.

    Args:
        xyz: (..., 3) float32 [m].

    Returns:
        (...) bool: false for points that are not finite, and for (0, 0, 0), which cameras send for a pixel without depth.
    """
    if np.isfinite(xyz).all() and xyz[..., 2].all():  # the points of an object, in a quarter of the time
        return np.ones(xyz.shape[:-1], np.bool_)
    x, y, z = np.moveaxis(xyz, -1, 0)  # reductions along rows of three are slow
    finite = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    return np.asarray(finite & ((z != 0.0) | (x != 0.0) | (y != 0.0)), np.bool_)


def _share(chosen: Bool) -> float:
    """Return the share of the chosen ones; 1 of none."""
    return np.count_nonzero(chosen) / chosen.size if chosen.size else 1.0
