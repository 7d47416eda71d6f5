# SPDX-License-Identifier: Apache-2.0
"""The best grasp on the true surface: what a method could reach at most that sees the whole object.

Lines through points of the surface, in directions within 25° of the inward normal, level or not, meet the object from both sides. Those stay whose forces
lie in the friction cones with a fifth to spare, whose contacts the hand can open to, and whose tips are clear of the table. They are ranked by
the steeper of the two contacts, in parts of the friction angle, plus the arm of the weight about the line, in parts of 20 mm.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.grasp_physics.objects import Item, Placed
from benchmarks.grasp_physics.simulation import FORCE_N, OUTSIDE_M
from foretouch.types import Float64

COUNT: Final = 10
_LINES = 6000
_TILT_DEG = 25.0  # of a line from the normal that it starts at, at most
_SPARE = 0.8  # of the friction angle
_ARM_M = 0.02
_SMOOTHED = 150  # of the candidates, ranked by the normals of faces: normals around the contacts decide among them
_APART_M = 0.01  # two grasps whose contacts are nearer are one
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where the tips of one or more grasps first meet the object."""

    points: Float64  # (n, 2, 3) float64 [m], NaN where a tip meets nothing
    closing: Float64  # (n, 2, 3) float64, unit, the way in which each tip moves
    normals: Float64  # (n, 2, 3) float64, outward, of the faces that they meet
    starts: Float64  # (n, 2, 3) float64 [m], where the tips start


def meet(surface: Placed, g1: Float64, g2: Float64, outside_m: float = OUTSIDE_M) -> Contacts:
    """First contacts of tips that close from outside of planned contacts (n, 3) in the world."""
    along = _unit(g2 - g1)
    closing = np.stack([along, -along], axis=1)
    starts = np.stack([g1, g2], axis=1) - outside_m * closing
    distance, normals = surface.first(starts.reshape(-1, 3), closing.reshape(-1, 3))
    with np.errstate(invalid="ignore"):
        points = starts + distance.reshape(-1, 2, 1) * closing
    points[~np.isfinite(points)] = np.nan
    return Contacts(points, closing, normals.reshape(-1, 2, 3), starts)


def slopes(contacts: Contacts, normals: Float64, weight_n: float) -> Float64:
    """(n, 2) angle between each tip's force, of which half of the weight is a part, and the inward normal (n, 2, 3) [rad]."""
    force = FORCE_N * contacts.closing + weight_n / 2.0 * _UP
    cosine = -np.einsum("ijk,ijk->ij", force, normals) / np.linalg.norm(force, axis=2)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def best_grasps(item: Item, surface: Placed, tip_radius_m: float, friction: float, opening_m: float) -> list[Float64]:
    """Up to ten grasps (2, 3) in the world [m], best first; none where no line passes."""
    lines = _lines(surface)
    found = meet(surface, *lines, outside_m=1.0)
    limit, weight_n = _SPARE * np.arctan(friction), item.mass_kg * 9.81
    near = replace(found, starts=found.points - OUTSIDE_M * found.closing)
    width = np.linalg.norm(found.points[:, 1] - found.points[:, 0], axis=1)
    steep = slopes(near, near.normals, weight_n).max(axis=1)
    touching = near.points - tip_radius_m * near.closing
    clearance = np.minimum(touching, near.starts)[..., 2].min(axis=1) - tip_radius_m  # of the lower tip from the table
    with np.errstate(invalid="ignore"):
        passes = (steep < limit) & (width < opening_m) & (width > 1e-3) & (clearance > 0.0)
    kept = np.flatnonzero(passes)
    order = kept[np.argsort(steep[kept] / limit + _arm(near, surface.centre)[kept] / _ARM_M, kind="stable")]
    ranked = []
    for k in order[:_SMOOTHED]:
        one = Contacts(*(field[[k]] for field in (near.points, near.closing, near.normals, near.starts)))
        smooth = np.stack([surface.smooth_normal(*pair) for pair in zip(one.points[0], one.normals[0], strict=True)])
        slope = float(slopes(one, smooth[None], weight_n).max())
        if slope < limit:
            ranked.append((slope / limit + float(_arm(one, surface.centre)[0]) / _ARM_M, one.points[0]))
    return _distinct([points for _, points in sorted(ranked, key=lambda pair: pair[0])])


def _lines(surface: Placed) -> tuple[Float64, Float64]:
    """Two points (n, 3) each on lines through points of the surface."""
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(surface.samples), _LINES, replace=False)
    tilt = np.tan(np.radians(_TILT_DEG)) * rng.uniform(-1.0, 1.0, (_LINES, 1))
    direction = tilt * _unit(rng.standard_normal((_LINES, 3))) - surface.normals[chosen]
    direction[::2, 2] = 0.0  # level
    direction[np.linalg.norm(direction, axis=1) < 0.1] = [1.0, 0.0, 0.0]
    return surface.samples[chosen], surface.samples[chosen] + 1e-3 * _unit(direction)


def _arm(contacts: Contacts, centre: Float64) -> Float64:
    """(n,) of the weight about the line of each grasp, and how far it is beyond both contacts, together [m]."""
    middle, half = contacts.points.mean(axis=1), np.linalg.norm(np.diff(contacts.points, axis=1)[:, 0], axis=1) / 2.0
    offset, along = (centre - middle)[:, :2], contacts.closing[:, 0, :2]
    beside = np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0])
    return np.asarray(beside + np.maximum(0.0, np.abs(np.einsum("ij,ij->i", offset, along)) - half), np.float64)


def _distinct(grasps: list[Float64]) -> list[Float64]:
    """The first ten grasps of which no two are nearly the same, whichever tip takes which contact."""
    kept: list[Float64] = []
    for grasp in grasps:
        apart = (np.linalg.norm(grasp - turned, axis=1).max() for one in kept for turned in (one, one[::-1]))
        if len(kept) < COUNT and all(distance > _APART_M for distance in apart):
            kept.append(grasp)
    return kept


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float64)
