# SPDX-License-Identifier: Apache-2.0
"""The true surface, which no camera sees, and its best grasps.

`best_grasps` draws lines through points of the surface, in directions within 25° of the inward normal, level or not. Those stay whose forces lie in
the friction cones with a fifth to spare, whose contacts the hand can open to, and whose tips are clear of the table. They are ranked by
the steeper of the two contacts, in parts of the friction angle, plus the arm of the weight about the line, in parts of 20 mm.
"""

from typing import Final, NamedTuple

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from benchmarks.grasp_physics.objects import Item
from benchmarks.grasp_physics.simulation import FORCE_N, OUTSIDE_M
from foretouch.types import Float64

COUNT: Final = 10
_SAMPLES, _LINES = 20000, 6000
_TILT_DEG = 25.0  # of a line from the normal that it starts at, at most
_SPARE = 0.8  # of the friction angle
_ARM_M = 0.02
_SMOOTHED = 150  # of the candidates, ranked by the normals of faces: normals around the contacts decide among them
_SMOOTH_M = 0.003  # around a contact
_APART_M = 0.01  # two grasps whose contacts are nearer are one
_UP = np.array([0.0, 0.0, 1.0])


class Contacts(NamedTuple):
    """Where the tips of one or more grasps first meet the object."""

    points: Float64  # (n, 2, 3) float64 [m], NaN where a tip meets nothing
    closing: Float64  # (n, 2, 3) float64, unit, the way in which each tip moves
    normals: Float64  # (n, 2, 3) float64, outward, of the faces that they meet; NaN where a tip meets nothing
    starts: Float64  # (n, 2, 3) float64 [m], where the tips start


class Placed:
    """The surface of an object at a pose (4, 4), object to world."""

    def __init__(self, item: Item, pose: Float64) -> None:
        self.mesh, self.pose, self.weight_n = item.at(pose), pose, item.mass_kg * 9.81
        self.centre = trimesh.transform_points(item.centre[None], pose)[0]
        self.samples, faces = trimesh.sample.sample_surface(self.mesh, _SAMPLES, seed=0)
        self.normals = self.mesh.face_normals[faces]
        self._tree = cKDTree(self.samples)

    def meet(self, g1: Float64, g2: Float64, outside_m: float = OUTSIDE_M) -> Contacts:
        """First contacts of tips that close from outside of planned contacts (n, 3) in the world."""
        along = _unit(g2 - g1)
        closing = np.stack([along, -along], axis=1)
        starts = np.stack([g1, g2], axis=1) - outside_m * closing
        origins, ways = starts.reshape(-1, 3), closing.reshape(-1, 3)
        hits, rays, faces = self.mesh.ray.intersects_location(origins, ways, multiple_hits=False)
        points, normals = np.full((2, len(ways), 3), np.nan)
        points[rays] = origins[rays] + np.einsum("ij,ij->i", hits - origins[rays], ways[rays])[:, None] * ways[rays]
        normals[rays] = self.mesh.face_normals[faces]
        return Contacts(points.reshape(closing.shape), closing, normals.reshape(closing.shape), starts)

    def slopes(self, contacts: Contacts) -> Float64:
        """(n, 2) angle between each tip's force, of which half of the weight is a part, and the inward normal [rad]."""
        force = FORCE_N * contacts.closing + self.weight_n / 2.0 * _UP
        cosine = -np.einsum("ijk,ijk->ij", force, contacts.normals) / np.linalg.norm(force, axis=2)
        return np.arccos(np.clip(cosine, -1.0, 1.0))

    def smooth(self, one: Contacts) -> Contacts:
        """One grasp with the mean normals around its contacts, of what faces the same way as the face there."""
        means = []
        for point, normal in zip(one.points[0], one.normals[0], strict=True):
            near = self.normals[self._tree.query_ball_point(point, _SMOOTH_M)]
            means.append(near[near @ normal > 0.5].sum(axis=0) + 1e-6 * normal)
        return one._replace(normals=_unit(np.stack(means))[None])


def best_grasps(surface: Placed, tip_radius_m: float, friction: float, opening_m: float) -> list[Float64]:
    """Up to ten grasps (2, 3) in the world [m], best first; none where no line passes."""
    found = surface.meet(*_lines(surface), outside_m=1.0)
    near = found._replace(starts=found.points - OUTSIDE_M * found.closing)
    limit = _SPARE * np.arctan(friction)

    def rank(contacts: Contacts) -> Float64:
        """(n,), infinite where a side is too steep or absent."""
        steep = surface.slopes(contacts).max(axis=1)
        return np.where(steep < limit, steep / limit + _arm(contacts, surface.centre) / _ARM_M, np.inf)

    width = np.linalg.norm(near.points[:, 1] - near.points[:, 0], axis=1)
    lowest = np.minimum(near.points - tip_radius_m * near.closing, near.starts)[..., 2].min(axis=1)  # of the tips
    ranks = np.where((width < opening_m) & (width > 1e-3) & (lowest > tip_radius_m), rank(near), np.inf)
    candidates = [Contacts(*(field[[k]] for field in near)) for k in np.argsort(ranks, kind="stable")[:_SMOOTHED] if ranks[k] < np.inf]  # fmt: skip
    ranked = [(float(rank(surface.smooth(one))[0]), one.points[0]) for one in candidates]
    return _distinct([points for value, points in sorted(ranked, key=lambda pair: pair[0]) if value < np.inf])


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
