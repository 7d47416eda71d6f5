# SPDX-License-Identifier: Apache-2.0
"""Heights of simple objects in the contact frame: what the pad is pressed on in examples and tests."""

from __future__ import annotations

import numpy as np

from foretouch.types import Float64

__all__ = ["bent_surface", "tilted", "wedge"]


def bent_surface(x: Float64, y: Float64, curvature_x: float, curvature_y: float, angle_rad: float = 0.0) -> Float64:
    """A surface with two principal curvatures [1/m]: plane, sphere or cylinder to second order.

    Args:
        x: (N, N) cell centres [m].
        y: (N, N) cell centres [m].
        curvature_x: First principal curvature, positive where it is convex, negative for a dent.
        curvature_y: The second, across the first.
        angle_rad: How far the first principal direction is turned from x towards y.

    Returns:
        (N, N) float64 [m], 0 at the origin.
    """
    u = np.cos(angle_rad) * x + np.sin(angle_rad) * y
    v = np.cos(angle_rad) * y - np.sin(angle_rad) * x
    return np.asarray(-(curvature_x * u**2 + curvature_y * v**2) / 2.0)


def wedge(x: Float64, y: Float64, slope: float, angle_rad: float = 0.0, rounding_m: float = 0.0) -> Float64:
    """The edge of a box: flat on one side of a line, falling with `slope` on the other [m].

    Args:
        x: (N, N) cell centres [m].
        y: (N, N) cell centres [m].
        slope: Fall over distance; infinite for an edge with nothing behind it.
        angle_rad: Direction of the fall, from x towards y.
        rounding_m: Distance over which the slope sets in.
    """
    across = np.cos(angle_rad) * x + np.sin(angle_rad) * y
    if np.isinf(slope):
        return np.where(across <= 0.0, 0.0, -np.inf)
    if rounding_m <= 0.0:
        return np.asarray(-slope * np.maximum(across, 0.0))
    inside = np.clip(across + rounding_m / 2.0, 0.0, rounding_m)
    return np.asarray(-slope * (inside**2 / (2.0 * rounding_m) + np.maximum(across - rounding_m / 2.0, 0.0)))


def tilted(height: Float64, x: Float64, y: Float64, slope_x: float, slope_y: float) -> Float64:
    """The same surface turned a little about the origin [m]: what the object's own tilt in the grip adds."""
    return height + slope_x * x + slope_y * y
