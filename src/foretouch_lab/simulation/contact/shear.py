# SPDX-License-Identifier: Apache-2.0
"""The forces along the skin that go with a solved contact: by the slope of the skin, and by friction.

Pressure acts along the normal of the skin as it is pressed in; where that is inclined by the slopes s to the plane of the
contact, it pushes along that plane by p s. Friction carries what is missing to the force T that the finger exerts along it:

    Q = T - Σ p s · cell, at most µ N (Coulomb),        q = µ (p(N) - p(N - Q/µ)) along Q

with p(N) the pressure under the normal force N. That is the partial slip of Cattaneo and Mindlin for any shape of contact
(Ciavarella 1998, Jäger 1998): inside of the contact of the smaller force the surfaces stick, and q <= µ p everywhere.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from foretouch.types import Float64
from foretouch_lab.simulation.contact.problem import ContactSolution

STEEPEST: Final = 1.0  # slope beyond which an edge counts as one of 45 degrees


def skin_slopes(depth: Float64, step_m: float) -> Float64:
    """(N, N, 2) slope of a surface along x and y from its depth (N, N) below a plane; 0 beside it, where depth is not finite."""
    height = np.where(np.isfinite(depth), -depth, np.nan)
    slopes = np.zeros((*depth.shape, 2))
    for k, axis in enumerate((1, 0)):
        steps = np.diff(height, axis=axis) / step_m
        before, after = (np.insert(steps, place, np.nan, axis=axis) for place in (0, steps.shape[axis]))
        known = np.isfinite(before).astype(np.int64) + np.isfinite(after)
        slopes[..., k] = (np.nan_to_num(before) + np.nan_to_num(after)) / np.maximum(known, 1)
    return np.clip(slopes, -STEEPEST, STEEPEST)


def tractions(
    contact: ContactSolution,
    cell_m2: float,
    slopes: Float64,
    tangential_n: Float64,
    friction: float,
    pressure_at: Callable[[float], Float64],
) -> Float64:
    """Force of an object on the skin, per area.

    Args:
        contact: The solved contact.
        cell_m2: Area of a cell [m²].
        slopes: (N, N, 2) of the pressed skin along x and y, as of `skin_slopes`.
        tangential_n: (2,) force of the object on the skin along x and y [N].
        friction: Coefficient µ.
        pressure_at: Gives the pressure (N, N) [Pa] under a smaller normal force [N].

    Returns:
        (N, N, 3) [Pa] along x, y and the outward normal; the last is minus the pressure.
    """
    pressure = contact.pressure
    along = pressure[..., None] * slopes
    missing = tangential_n - along.sum(axis=(0, 1)) * cell_m2
    size = float(np.linalg.norm(missing))
    if size > 0.0 and friction > 0.0:
        left_n = contact.force_n - size / friction
        sliding = pressure if left_n <= 0.0 else pressure - pressure_at(left_n)
        along = along + friction * np.maximum(sliding, 0.0)[..., None] * (missing / size)
    return np.concatenate([along, -pressure[..., None]], axis=-1)
