# SPDX-License-Identifier: Apache-2.0
"""Refuse grasps that no hand can execute: wider than it opens, or off the object; and flag those that meet nothing."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.kernels import Kernel
from foretouch.types import Bool, Float64, Floating, Grasp, Grasps, Index
from foretouch.types.rotations import require_none

_SAMPLED = 256  # points tried first: one within reach is sufficient
_FIRST, _WIDE_M = 16, 0.05  # one in sixteen of them is sufficient for most contacts from this distance on
_TOGETHER = 8192  # pairs of a point and a contact at a time
_SURELY, _ROUNDED = 0.9, 0.05  # of a distance: a contact that float32 moves by less of it and has nearer is within it
_OFF_M = 0.02  # from the object and what it hides, where a contact is in the air; planned ones are nearer

_nearest_squares = Kernel("nearest_squares")

EXECUTED_M: Final = 2.0
"""Width of a grasp that was executed with whatever hand: wider ones are in another unit [m]."""

ASTRAY_M: Final = 0.3
"""Distance of an executed contact from the nearest point of its object, from which on they are in different frames [m]."""

OFF_OBJECT: Final = "off_object"
"""Flag of a grasp with a contact in the air: the camera sees that the object is not there."""


@dataclass(frozen=True, kw_only=True)
class ReachConfig(Settings):
    """The hand's reach. By default, of a Shadow Hand with thumb and middle finger."""

    max_width_m: float = setting(0.2, "Grasps whose contacts are farther apart are refused", bounds=(0.001, 10.0))
    max_distance_m: float = setting(
        0.1, "Grasps with a contact farther from the object's nearest point are refused", bounds=(0.0, 10.0)
    )


DEFAULT_REACH = ReachConfig()


def check_reach(grasp: Grasp, cloud_xyz: Floating, max_width_m: float, max_distance_m: float) -> None:
    """Refuse a grasp that `reach_faults` names.

    Args:
        grasp: The grasp.
        cloud_xyz: (N, 3) points of the object [m].
        max_width_m: Largest distance of the contacts [m].
        max_distance_m: Largest distance of a contact from the object [m].

    Raises:
        GraspError: Names the measure and its limit.
    """
    require_none(reach_faults(Grasps.of([grasp]), cloud_xyz, max_width_m, max_distance_m))


def reach_faults(grasps: Grasps, cloud_xyz: Floating, max_width_m: float, max_distance_m: float) -> list[str]:
    """Say which of K grasps are wider than a hand opens, or have a contact off the object.

    Args:
        grasps: In the cloud's frame.
        cloud_xyz: (..., 3) floating [m], the object's points; those that are not finite are ignored.
        max_width_m: Largest distance of the contacts [m].
        max_distance_m: Largest distance of a contact from the nearest point [m].

    Returns:
        The measure and its limit for each grasp, "" where the hand reaches.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        across = grasps.g1 - grasps.g2
        width = np.hypot(np.hypot(across[:, 0], across[:, 1]), across[:, 2])
    faults = [""] * len(grasps)
    for k in np.flatnonzero(~(width <= max_width_m)).tolist():
        faults[k] = f"g1, g2: {width[k]:.4g} m apart, more than max_width_m {max_width_m:g}"
    points, contacts = cloud_xyz.reshape(-1, 3), np.concatenate([grasps.g1, grasps.g2])
    for place in _off(points, contacts, max_distance_m, _near).tolist():
        name, k = ("g1", "g2")[place // len(grasps)], place % len(grasps)
        away = f"{_nearest_m(points, contacts[place]):.4g} m from the object"
        faults[k] = faults[k] or f"{name}: {away}, more than max_distance_m {max_distance_m:g}"
    return faults


def in_the_air(grasps: Grasps, cloud_xyz: Floating) -> Bool:
    """Return (K,) which grasps have a contact more than 20 mm from the object and from all that it hides from the camera.

    Args:
        grasps: K grasps of finite contacts, in the frame of the camera.
        cloud_xyz: (..., 3) floating [m], the object's points; those that are not finite are ignored.
    """
    found = np.zeros(len(grasps), np.bool_)
    contacts = np.concatenate([grasps.g1, grasps.g2])
    found[_off(cloud_xyz.reshape(-1, 3), contacts, _OFF_M, _near_or_hidden) % max(1, len(grasps))] = True
    return found


def _off(
    points: Floating, contacts: Float64, distance_m: float, near: Callable[[Floating, Float64, float], Bool]
) -> Index:
    """Return which of (K, 3) contacts have no point within a distance, by a rule that says which have.

    A sample of the points is tried first: it is within reach of most contacts.
    """
    few = points[:: max(1, len(points) // _SAMPLED)]
    first = few if distance_m < _WIDE_M else few[_FIRST // 2 :: _FIRST]
    left = np.flatnonzero(~_surely_near(first, contacts, distance_m))
    step = max(16, _TOGETHER // max(1, len(left)))
    for k in range(0, len(few), step):
        if not left.size:
            return left
        left = left[~near(few[k : k + step], contacts[left], distance_m)]
    return np.array([k for k in left.tolist() if not near(points, contacts[k : k + 1], distance_m)[0]], np.intp)


def _surely_near(points: Floating, contacts: Float64, distance_m: float) -> Bool:
    """Return (K,) which contacts are near one of (N, 3) points, whatever the rounding of float32; most of a hand's are."""
    squares = np.empty(len(contacts), np.float32)
    with np.errstate(over="ignore"):
        columns, targets = np.ascontiguousarray(points.T, np.float32), contacts.astype(np.float32)
        moved = np.abs(contacts - targets).max(axis=1)
    _nearest_squares(targets, len(targets), columns, len(points), squares)
    return np.asarray((squares < (_SURELY * distance_m) ** 2) & (moved < _ROUNDED * distance_m), np.bool_)


def _near(points: Floating, contacts: Float64, distance_m: float) -> Bool:
    """Return (K,) whether any of (N, 3) points is within a distance of each contact; points that are not finite are not."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = ((contacts[:, None] - points) ** 2).sum(axis=2)
        return np.asarray((squares <= distance_m * distance_m).any(axis=1), np.bool_)


def _near_or_hidden(points: Floating, contacts: Float64, distance_m: float) -> Bool:
    """As `_near`, of any of (N, 3) points and of the rays behind them, as the camera at the origin sees them."""
    with np.errstate(all="ignore"):
        seen = points.astype(np.float64)
        squares, dots = (seen * seen).sum(axis=1), contacts @ seen.T
        along = np.maximum(dots / squares, 1.0)  # of the ray, where it is nearest to the contact
        apart = (contacts * contacts).sum(axis=1)[:, None] + along * (along * squares - 2.0 * dots)
        return np.asarray((apart <= distance_m * distance_m).any(axis=1), np.bool_)


def _nearest_m(points: Floating, contact: Float64) -> float:
    """Return the distance of the nearest finite point [m]; infinite without one."""
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    return min((math.dist(point, contact.tolist()) for point in finite.tolist()), default=math.inf)
