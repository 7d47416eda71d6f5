# SPDX-License-Identifier: Apache-2.0
"""Whether a grasp can carry an object of a given mass, by the friction at both contacts.

Both fingertips press along the line, and share the weight as the centre of mass lies between them. The force at a contact must be within the friction
cone around the normal of the surface there, which is that of the seen points, mirrored where the side is hidden. A side of which nothing is known is upright.
"""

from typing import Final

import numpy as np

from foretouch.types import Float64

CANNOT_CARRY: Final = "cannot_carry"
"""Flag of a grasp whose friction does not carry the object's mass."""

_GRAVITY_M_S2: Final = 9.81
_LIFT_M_S2: Final = 1.6  # of a lift by 10 cm in half a second, whose largest acceleration is half as much more
_PATCH_M: Final = 0.02  # beside, over and below a contact, whose points are the surface there
_OUTSIDE_M, _INSIDE_M = 0.01, 0.015  # of the contact, along the line
_FEWEST, _LOWEST_M = 6, 0.004  # points, and their extent in height, that show a slope
_ROUNDS = 3  # of the fit
_BEHIND_M = 0.002  # the surface; in each round, the weight of a point so far behind it falls by a factor of e
_STEEP: Final = 0.8  # of the friction angle, at most: the planner prefers lines that meet nothing steeper


def strain(ends: Float64, points: Float64, weights: Float64, mass_kg: float, friction: float, force_n: float) -> float:
    """Compute how much friction the worse contact of a grasp needs, over what it has: above 1 it slips while the object is lifted.

    Args:
        ends: (2, 3) float64 [m], both contacts on a level line; z is up, and the centre of mass over the origin.
        points: (N, 3) float64 [m], of the object.
        weights: (N,) float64, of the points, 0 ... 1.
        mass_kg: Of the object.
        friction: Coefficient between fingertips and object.
        force_n: With which each fingertip presses [N].
    """
    middle, width = ends.mean(axis=0), float(np.linalg.norm(ends[1] - ends[0]))
    along = (ends[1] - ends[0]) / width
    along_m, beside_m = (points - middle) @ along, (points - middle) @ np.array([-along[1], along[0], 0.0])
    share = float(np.clip(0.5 - middle @ along / width, 0.0, 1.0))  # of the second fingertip
    weight_n, worst = mass_kg * (_GRAVITY_M_S2 + _LIFT_M_S2), 0.0
    for sign, part in ((-1.0, 1.0 - share), (1.0, share)):
        patch = np.stack([sign * along_m - width / 2.0, beside_m, points[:, 2] - middle[2]], axis=1)
        normal = _normal(patch, weights, _STEEP * np.arctan(friction))
        force = np.array([-force_n, 0.0, part * weight_n])  # on the object: inwards, and up
        pressed = max(-float(force @ normal), 1e-9)
        worst = max(worst, float(np.linalg.norm(force + pressed * normal)) / (friction * pressed))
    return worst


def _normal(patch: Float64, weights: Float64, steepest_rad: float) -> Float64:
    """Return the outward normal (3,) of the surface around a contact, from points (N, 3) outwards, beside and over it [m]."""
    outwards, beside, up = patch.T
    near = (np.abs(beside) < _PATCH_M) & (np.abs(up) < _PATCH_M) & (outwards > -_INSIDE_M) & (outwards < _OUTSIDE_M)
    near &= weights > 0.0
    normal = np.array([1.0, 0.0, 0.0])
    if np.count_nonzero(near) < _FEWEST or np.ptp(up[near]) < _LOWEST_M:
        return normal
    plane, share = np.stack([np.ones(np.count_nonzero(near)), beside[near], up[near]], axis=1), weights[near]
    for _ in range(_ROUNDS):
        root = np.sqrt(share)
        fit = np.linalg.lstsq(plane * root[:, None], outwards[near] * root, rcond=None)[0]
        share = share * np.exp(np.clip((outwards[near] - plane @ fit) / _BEHIND_M, -4.0, 0.0))
    slope = float(np.hypot(*fit[1:]))
    normal[1:] = -fit[1:] * min(1.0, np.tan(steepest_rad) / max(slope, 1e-9))
    return np.asarray(normal / np.linalg.norm(normal), np.float64)
