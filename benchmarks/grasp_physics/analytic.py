# SPDX-License-Identifier: Apache-2.0
"""The second opinion on a grasp, without simulation: by the friction cones where both tips first meet the object.

Each tip is a ray along the line through both planned contacts, from 3 cm outside. At its first contact it pushes with 5 N along the line, and
carries half of the weight. The grasp holds if that force lies in the friction cone of both contacts, and if the object, which swings about the line until its centre of
mass hangs below it unless the spin of the contacts stops that, is clear of the table once lifted. Motion is left out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import trimesh

from benchmarks.grasp_physics.objects import Item, Placed
from benchmarks.grasp_physics.simulation import BESIDE, FORCE_N, HANGS, HELD, INSIDE, LIFT_M, OUTSIDE_M, SPIN_M, Outcome
from foretouch.types import Float64

CONE: Final = "outside of the friction cone"
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
    along = (g2 - g1) / np.linalg.norm(g2 - g1, axis=1, keepdims=True)
    closing = np.stack([along, -along], axis=1)
    starts = np.stack([g1, g2], axis=1) - outside_m * closing
    distance, normals = surface.first(starts.reshape(-1, 3), closing.reshape(-1, 3))
    with np.errstate(invalid="ignore"):
        points = starts + distance.reshape(-1, 2, 1) * closing
    points[~np.isfinite(points)] = np.nan
    return Contacts(points, closing, normals.reshape(-1, 2, 3), starts)


def slopes(contacts: Contacts, normals: Float64, weight_n: float) -> Float64:
    """(n, 2) angle between each tip's force and the inward normal (n, 2, 3) [rad]."""
    force = FORCE_N * contacts.closing + weight_n / 2.0 * _UP
    cosine = -np.einsum("ijk,ijk->ij", force, normals) / np.linalg.norm(force, axis=2)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def clearance(contacts: Contacts, tip_radius_m: float) -> Float64:
    """(n,) of the lower tip from the table, at its start and at its contact, the lesser [m]."""
    touching = contacts.points - tip_radius_m * contacts.closing
    return np.asarray(np.minimum(touching, contacts.starts)[..., 2].min(axis=1) - tip_radius_m, np.float64)


def close(
    item: Item, surface: Placed, g1: Float64, g2: Float64, tip_radius_m: float = 0.008, friction: float = 0.8
) -> Outcome:
    """What the friction cones say of one grasp; arguments as those of `simulation.held`, at the pose of `surface`."""
    if not float(np.linalg.norm(g2 - g1)) > 1e-4:
        return Outcome(BESIDE)
    found = meet(surface, g1[None], g2[None])
    if np.isnan(found.points).any():
        return Outcome(BESIDE)
    if (np.einsum("ijk,ijk->ij", found.normals, found.closing) > 0.0).any():
        return Outcome(INSIDE)
    smooth = [
        surface.smooth_normal(point, normal) for point, normal in zip(found.points[0], found.normals[0], strict=True)
    ]
    opening = float(np.linalg.norm(found.points[0, 1] - found.points[0, 0]))
    within = slopes(found, np.stack(smooth)[None], item.mass_kg * 9.81).max() <= np.arctan(friction)
    reason = CONE if not within else HELD if _swings_clear(surface, found, item.mass_kg * 9.81) else HANGS
    return Outcome(reason, opening, float(clearance(found, tip_radius_m)[0]))


def _swings_clear(surface: Placed, contacts: Contacts, weight_n: float) -> bool:
    """Whether the object is clear of the table, lifted and hanging."""
    point, along = contacts.points[0, 0], contacts.closing[0, 0]
    arm, down = (vector - along * (vector @ along) for vector in (surface.centre - point, -_UP))
    torque = weight_n * float(np.linalg.norm(np.cross(arm, down)))
    if torque < 2.0 * SPIN_M * FORCE_N:
        return True
    angle = np.arctan2(np.cross(arm, down) @ along, arm @ down)
    turn = trimesh.transformations.rotation_matrix(angle, along, point)
    lowest = trimesh.transform_points(surface.mesh.vertices, turn)[:, 2].min()
    return bool(lowest + LIFT_M > 0.0)
