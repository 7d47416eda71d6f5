# SPDX-License-Identifier: Apache-2.0
"""The best grasp on the true surface, which no camera sees.

Lines go through points of the surface, in directions within 25° of the inward normal, level or not. Those stay whose forces lie in the friction
cones with a fifth to spare, whose contacts the hand can open to, and whose tips are clear of the table. They are ranked by the steeper of
the two contacts, in parts of the friction angle, plus the arm of the weight about the line, in parts of 20 mm.
"""

from typing import Final

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from benchmarks.grasp_physics.objects import Item
from benchmarks.grasp_physics.simulation import FORCE_N, OPENING_M, OUTSIDE_M
from foretouch.types import Float64

_SAMPLES, _LINES = 20000, 6000
_TILT_DEG: Final = 25.0  # of a line from the normal that it starts at, at most
_SPARE: Final = 0.8  # of the friction angle
_ARM_M: Final = 0.02
_SMOOTHED: Final = 150  # candidates, ranked by the normals of faces; mean normals around the contacts decide
_SMOOTH_M: Final = 0.003  # around a contact


def best_grasp(item: Item, pose: Float64, tip_radius_m: float, friction: float) -> Float64 | None:
    """Return contacts (2, 3) in the world [m] on an object at a pose (4, 4), object to world; None where no line passes."""
    mesh = item.at(pose)
    samples, faces = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)
    around, tree = mesh.face_normals[faces], cKDTree(samples)
    points, closing, normals = meet(mesh, *_lines(samples, around), outside_m=1.0)
    arm = _arm(points, closing, trimesh.transform_points(item.centre[None], pose)[0])
    force = FORCE_N * closing + [0.0, 0.0, item.mass_kg * 9.81 / 2.0]  # half of the weight is a part of it
    force /= np.linalg.norm(force, axis=2, keepdims=True)

    def rank(normals: Float64, rows: slice | int) -> Float64:
        """Return the rank of some lines by their outward normals (n, 2, 3): infinite where a side is too steep or absent."""
        slope = np.arccos(np.clip(-np.einsum("...k,...k->...", force[rows], normals), -1.0, 1.0)).max(axis=-1)
        limit = _SPARE * np.arctan(friction)
        return np.where(slope < limit, slope / limit + arm[rows] / _ARM_M, np.inf)

    width = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
    ends = np.stack([points - tip_radius_m * closing, points - OUTSIDE_M * closing])  # of the ways of the tips
    admitted = (width < OPENING_M) & (width > 1e-3) & (ends[..., 2].min(axis=(0, 2)) > tip_radius_m)
    ranks = np.where(admitted, rank(normals, slice(None)), np.inf)
    best, least = None, np.inf
    for k in np.argsort(ranks, kind="stable")[:_SMOOTHED]:
        if ranks[k] < np.inf:
            near = [around[some] for some in tree.query_ball_point(points[k], _SMOOTH_M)]
            sums = [some[some @ own > 0.5].sum(axis=0) + 1e-6 * own for some, own in zip(near, normals[k], strict=True)]
            if (value := float(rank(_unit(np.stack(sums)), int(k)))) < least:
                best, least = points[k], value
    return best


def meet(mesh: trimesh.Trimesh, g1: Float64, g2: Float64, outside_m: float) -> tuple[Float64, Float64, Float64]:
    """Return where tips first meet a mesh that close from outside of planned contacts (n, 3).

    Returns:
        (n, 2, 3) float64 points [m], ways in which the tips move, and outward normals there; points and normals are NaN where nothing is met.
    """
    along = _unit(g2 - g1)
    closing = np.stack([along, -along], axis=1)
    origins, ways = (np.stack([g1, g2], axis=1) - outside_m * closing).reshape(-1, 3), closing.reshape(-1, 3)
    hits, rays, faces = mesh.ray.intersects_location(origins, ways, multiple_hits=False)
    points, normals = np.full((2, len(ways), 3), np.nan)
    points[rays] = origins[rays] + np.einsum("ij,ij->i", hits - origins[rays], ways[rays])[:, None] * ways[rays]
    normals[rays] = mesh.face_normals[faces]
    return points.reshape(closing.shape), closing, normals.reshape(closing.shape)


def _lines(samples: Float64, normals: Float64) -> tuple[Float64, Float64]:
    """Return two points (n, 3) each on lines through points of the surface."""
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(samples), _LINES, replace=False)
    tilt = np.tan(np.radians(_TILT_DEG)) * rng.uniform(-1.0, 1.0, (_LINES, 1))
    direction = tilt * _unit(rng.standard_normal((_LINES, 3))) - normals[chosen]
    direction[::2, 2] = 0.0  # level
    direction[np.linalg.norm(direction, axis=1) < 0.1] = [1.0, 0.0, 0.0]
    return samples[chosen], samples[chosen] + 1e-3 * _unit(direction)


def _arm(points: Float64, closing: Float64, centre: Float64) -> Float64:
    """Return (n,) the arm of the weight about the line of each grasp, and how far it is beyond both contacts, together [m]."""
    middle, half = points.mean(axis=1), np.linalg.norm(np.diff(points, axis=1)[:, 0], axis=1) / 2.0
    offset, along = (centre - middle)[:, :2], closing[:, 0, :2]
    beside = np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0])
    return np.asarray(beside + np.maximum(0.0, np.abs(np.einsum("ij,ij->i", offset, along)) - half), np.float64)


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float64)
