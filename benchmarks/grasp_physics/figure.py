# SPDX-License-Identifier: Apache-2.0
"""Grasps from the side and from above: what the camera sees, the true surface, and where the tips meet it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import trimesh
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Circle

from benchmarks.grasp_physics.simulation import OUTSIDE_M
from benchmarks.grasp_physics.surface import meet
from foretouch.report.panels import new_figure, save_small
from foretouch.types import Float64

_SLICE_M: Final = 0.008  # points so near to the plane of a view are drawn


class Case(NamedTuple):
    """One grasp to draw."""

    title: str
    mesh: trimesh.Trimesh  # of the object, world [m]
    points: Float64  # (n, 3) float64, what the camera sees, world [m]
    contacts: Float64  # (2, 3) float64, planned, world [m]
    tip_m: float  # radius


def draw(cases: Sequence[Case], path: Path) -> None:
    """Write the picture: a column for each grasp."""
    figure = new_figure(2.6 * len(cases), 5.6)
    axes = figure.subplots(2, len(cases), squeeze=False)
    up = np.array([0.0, 0.0, 1.0])
    for case, (side, above) in zip(cases, axes.T, strict=True):
        along = case.contacts[1] - case.contacts[0]
        level = along * [1.0, 1.0, 0.0] if np.hypot(*along[:2]) > 0.2 * np.linalg.norm(along) else np.eye(3)[0]
        level /= np.linalg.norm(level)
        beside = np.cross(up, level)
        side.set_title(case.title, fontsize=9)
        _draw_view(side, np.stack([level, up, beside]), case)
        _draw_view(above, np.stack([level, beside, up]), case)
        side.axhline(-1e3 * case.contacts[:, 2].mean(), color="sienna", linewidth=2)  # the table
    save_small(figure, path)


def _draw_view(axis: Any, frame: Float64, case: Case) -> None:
    """One view; `frame` (3, 3) has right, up and the direction of view as rows; its origin is the middle of the contacts."""
    origin = case.contacts.mean(axis=0)

    def flat(xyz: Float64) -> Float64:
        """Return places in the view [mm]."""
        return np.asarray(1e3 * ((xyz - origin) @ frame[:2].T), np.float64)

    axis.add_collection(PolyCollection(flat(case.mesh.triangles), facecolors="0.9", edgecolors="0.9"))
    cut = trimesh.intersections.mesh_plane(case.mesh, frame[2], origin)
    axis.add_collection(LineCollection(flat(cut) if len(cut) else [], colors="black", linewidths=1.2))
    near = np.abs((case.points - origin) @ frame[2]) < _SLICE_M
    axis.scatter(*flat(case.points[near]).T, s=2.0, color="tab:orange")
    axis.plot(*flat(case.contacts).T, "x--", color="tab:red")
    met, closing, _ = meet(case.mesh, case.contacts[:1], case.contacts[1:], OUTSIDE_M)
    starts, ends = case.contacts - OUTSIDE_M * closing[0], met[0] - case.tip_m * closing[0]
    for middles, style in ((starts, ":"), (ends[np.isfinite(ends).all(axis=1)], "-")):
        for middle in flat(middles):
            axis.add_patch(Circle(middle, 1e3 * case.tip_m, fill=False, color="tab:blue", linestyle=style))
    axis.set_aspect("equal", adjustable="datalim")
    axis.tick_params(labelsize=6)
