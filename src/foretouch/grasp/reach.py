# SPDX-License-Identifier: Apache-2.0
"""Refuse grasps that no hand can execute: wider than it opens, or off the object."""

import math
from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import GraspError
from foretouch.types import Bool, Float64, Floating, Grasp

_SAMPLED = 256  # points tried first: one within reach is sufficient
_TOGETHER = 16  # of them at a time, for many grasps
_CLEARLY = 1.0 - 1e-9  # of a squared limit, so that rounding does not matter


@dataclass(frozen=True, kw_only=True)
class ReachConfig(Settings):
    """The hand's reach. The defaults are those of a Shadow Hand, thumb and middle finger."""

    max_width_m: float = setting(0.2, "Grasps whose contacts are farther apart are refused", bounds=(0.001, 10.0))
    max_distance_m: float = setting(
        0.1, "Grasps with a contact farther from the object's nearest point are refused", bounds=(0.0, 10.0)
    )


DEFAULT_REACH = ReachConfig()


def check_reach(grasp: Grasp, cloud_xyz: Floating, max_width_m: float, max_distance_m: float) -> None:
    """Check that a hand can open as wide as a grasp, and that both contacts are at the object.

    Args:
        grasp: In the cloud's frame.
        cloud_xyz: (..., 3) floating [m], the object's points; those that are not finite are ignored.
        max_width_m: Largest distance of the contacts [m].
        max_distance_m: Largest distance of a contact from the nearest point [m].

    Raises:
        GraspError: Names the measure and its limit.
    """
    width = math.dist(grasp.g1.tolist(), grasp.g2.tolist())
    if not width <= max_width_m:
        raise GraspError(f"g1, g2: {width:.4g} m apart, more than max_width_m {max_width_m:g}")
    points = cloud_xyz.reshape(-1, 3)
    for name, contact in (("g1", grasp.g1), ("g2", grasp.g2)):
        few = points[:: max(1, len(points) // _SAMPLED)]
        if not _within(few, contact, max_distance_m) and not _within(points, contact, max_distance_m):
            away = f"{_nearest_m(points, contact):.4g} m from the object"
            raise GraspError(f"{name}: {away}, more than max_distance_m {max_distance_m:g}")


def fast_accept_reach(g1: Float64, g2: Float64, cloud_xyz: Floating, max_width_m: float, max_distance_m: float) -> Bool:
    """(K,) whether `check_reach` accepts each pair of (K, 3) contacts; false where it has to decide.

    A sample of the points is tried, the middle one first, which is within reach of most contacts.
    """
    points = cloud_xyz.reshape(-1, 3)
    few = points[:: max(1, len(points) // _SAMPLED)].astype(np.float64)
    few = few[np.isfinite(few).all(axis=1)]
    middle = len(few) // 2
    parts = [slice(middle, middle + 1), *(slice(k, k + _TOGETHER) for k in range(0, len(few), _TOGETHER))]
    with np.errstate(over="ignore", invalid="ignore"):
        accepted = np.asarray(((g1 - g2) ** 2).sum(axis=1) <= _CLEARLY * max_width_m**2, np.bool_)
        for contacts in (g1, g2):
            left = np.flatnonzero(accepted)
            for part in parts:
                apart = ((contacts[left][:, None] - few[part]) ** 2).sum(axis=2)
                left = left[~(apart <= _CLEARLY * max_distance_m**2).any(axis=1)]
                if not left.size:
                    break
            accepted[left] = False
    return accepted


def _within(points: Floating, contact: Float64, distance_m: float) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        apart = points - contact
        return bool((np.einsum("ij,ij->i", apart, apart) <= distance_m * distance_m).any())


def _nearest_m(points: Floating, contact: Float64) -> float:
    """Distance of the nearest finite point [m]; infinite without one."""
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    return min((math.dist(point, contact.tolist()) for point in finite.tolist()), default=math.inf)
