# SPDX-License-Identifier: Apache-2.0
"""Grasps from the side and from above: what the camera sees, the true surface, and where the tips meet it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import trimesh
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from benchmarks.grasp_physics.surface import Placed
from foretouch.report.panels import new_figure, save_small
from foretouch.types import Float64

_COLUMNS: Final = 5
_SLICE_M: Final = 0.008  # points so near to the plane of a view are drawn strongly
_ARROW_M: Final = 0.022
_LEGEND: Final = (
    ("points that the camera sees (strong: near the grasp's plane)", "tab:orange", {"marker": ".", "linestyle": ""}),
    ("true outline in the grasp's plane", "black", {}),
    ("planned contact", "tab:red", {"marker": "x", "linestyle": ""}),
    ("tip, at its start and where it meets the object", "tab:blue", {"marker": "o", "linestyle": "", "markerfacecolor": "none"}),
    ("inward normal of the true surface there", "tab:green", {}),
)  # fmt: skip


class Case(NamedTuple):
    """One grasp to draw."""

    title: str
    surface: Placed
    points: Float64  # (n, 3) float64, what the camera sees, world [m]
    contacts: Float64  # (2, 3) float64, planned, world [m]
    tip_m: float  # radius


def draw(cases: Sequence[Case], path: Path) -> None:
    """Write the picture."""
    blocks = -(-len(cases) // _COLUMNS)
    figure = new_figure(2.9 * _COLUMNS, 5.3 * blocks + 0.4)
    axes = figure.subplots(2 * blocks, _COLUMNS, squeeze=False)
    for axis in axes.ravel():
        axis.set_axis_off()
    for k, case in enumerate(cases):
        block, column = divmod(k, _COLUMNS)
        side, above = axes[2 * block : 2 * block + 2, column]
        up, level = np.array([0.0, 0.0, 1.0]), (case.contacts[1] - case.contacts[0]) * [1.0, 1.0, 0.0]
        if np.linalg.norm(level) < 0.2 * np.linalg.norm(case.contacts[1] - case.contacts[0]):
            level = np.array([1.0, 0.0, 0.0])  # of a line that is nearly upright
        level /= np.linalg.norm(level)
        beside = np.cross(up, level)
        side.set_title(case.title, fontsize=9)
        _draw_view(side, np.stack([level, up, beside]), case, "from the side")
        _draw_view(above, np.stack([level, beside, up]), case, "from above")
        side.axhline(-1e3 * case.contacts[:, 2].mean(), color="sienna", linewidth=2)  # the table
    handles = [Line2D([], [], color=colour, label=text, **style) for text, colour, style in _LEGEND]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9)
    save_small(figure, path)


def _draw_view(axis: Any, frame: Float64, case: Case, name: str) -> None:
    """One view; `frame` (3, 3) has right, up and the direction of view as rows; its origin is the middle of the contacts."""
    surface, contacts, origin = case.surface, case.contacts, case.contacts.mean(axis=0)

    def flat(xyz: Float64) -> Float64:
        """In millimetres."""
        return np.asarray(1e3 * ((xyz - origin) @ frame[:2].T), np.float64)

    axis.add_collection(PolyCollection(flat(surface.mesh.triangles), facecolors="0.9", edgecolors="0.9"))
    cut = trimesh.intersections.mesh_plane(surface.mesh, frame[2], origin)
    axis.add_collection(LineCollection(flat(cut) if len(cut) else [], colors="black", linewidths=1.2))
    near = np.abs((case.points - origin) @ frame[2]) < _SLICE_M
    for chosen, size, alpha in ((~near, 1.0, 0.15), (near, 3.0, 0.9)):
        axis.scatter(*flat(case.points[chosen]).T, s=size, alpha=alpha, color="tab:orange", linewidths=0)
    axis.plot(*flat(contacts).T, "x--", color="tab:red", markersize=7, markeredgewidth=2, linewidth=1)
    blue = {"fill": False, "color": "tab:blue"}
    for point, closing, normal, start in zip(*(field[0] for field in surface.meet(contacts[:1], contacts[1:])), strict=True):  # fmt: skip
        axis.add_patch(Circle(flat(start), 1e3 * case.tip_m, linestyle=":", **blue))
        if np.isfinite(point).all():
            axis.add_patch(Circle(flat(point - case.tip_m * closing), 1e3 * case.tip_m, linewidth=1.5, **blue))
            arrow = {"arrowstyle": "->", "color": "tab:green", "linewidth": 1.8}
            axis.annotate("", flat(point - _ARROW_M * normal), flat(point), arrowprops=arrow)
    margin = np.array([45.0, 0.0])
    ends = np.concatenate([flat(surface.mesh.vertices), flat(contacts) - margin, flat(contacts) + margin])
    middle, half = (ends.max(axis=0) + ends.min(axis=0)) / 2.0, float(np.ptp(ends, axis=0).max()) / 2.0 + 8.0
    low, right = middle[1] - 0.88 * half, middle[0] + 0.95 * half
    axis.plot([right - 20.0, right], [low, low], color="black", linewidth=2)
    axis.text(0.02, 0.02, name, transform=axis.transAxes, fontsize=8)
    axis.text(0.98, 0.02, "20 mm", transform=axis.transAxes, fontsize=8, ha="right")
    axis.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
