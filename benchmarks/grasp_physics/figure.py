# SPDX-License-Identifier: Apache-2.0
"""A grasp that holds and one of each kind of failure, from the side and from above."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.grasp_physics import analytic
from benchmarks.grasp_physics.camera import see
from benchmarks.grasp_physics.measure import Row, Task
from benchmarks.grasp_physics.methods import DEFAULT, METHODS, NO_GRASP, NO_OBJECT, RULE, Planner, find
from benchmarks.grasp_physics.objects import Placed
from benchmarks.grasp_physics.simulation import HELD
from foretouch.report.panels import new_figure, save_small
from foretouch.types import Float64

_COLUMNS: Final = 5
_SLICE_M: Final = 0.008  # points so near to the plane of a view are drawn strongly
_ARROW_MM: Final = 22.0
_LEGEND: Final = (
    ("points that the camera sees (strong: near the grasp's plane)", "tab:orange", "."),
    ("true outline in the grasp's plane", "black", "-"),
    ("planned contact", "tab:red", "x"),
    ("tip, at its start and where it meets the object", "tab:blue", "o"),
    ("inward normal of the true surface there", "tab:green", "-"),
)


def draw(rows: Sequence[Row], tasks: Sequence[Task], path: Path) -> None:
    """Write the picture; grasps are planned again."""
    cases = _cases(rows)
    blocks = -(-len(cases) // _COLUMNS)
    figure = new_figure(2.9 * _COLUMNS, 5.3 * blocks + 0.4)
    axes = figure.subplots(2 * blocks, _COLUMNS, squeeze=False)
    for axis in axes.ravel():
        axis.set_axis_off()
    by_name = {task.item.name: task for task in tasks}
    for k, row in enumerate(cases):
        block, column = divmod(k, _COLUMNS)
        pair = axes[2 * block, column], axes[2 * block + 1, column]
        _draw_case(pair, row, by_name[row.object])
    figure.legend(handles=[_handle(*entry) for entry in _LEGEND], loc="outside lower center", ncols=3, fontsize=9)
    save_small(figure, path)


def _handle(text: str, colour: str, style: str) -> Any:
    from matplotlib.lines import Line2D

    if style == "-":
        return Line2D([], [], color=colour, label=text)
    filled = "none" if style == "o" else colour
    return Line2D([], [], linestyle="", marker=style, color=colour, markerfacecolor=filled, label=text)


def _cases(rows: Sequence[Row]) -> list[Row]:
    """One row for each reason, grasps that hold first, under the first conditions.

    Of the default method where there is one, else of another and last of the simple rule, and of as many objects as possible.
    """
    order = [DEFAULT, *(name for name in METHODS if name not in {DEFAULT, RULE}), RULE]
    planned = [row for row in rows if row.method in order and row.reason not in {NO_GRASP, NO_OBJECT}]
    planned = [row for row in planned if (row.tip_mm, row.friction) == (rows[0].tip_mm, rows[0].friction)]
    found: list[Row] = []

    def rank(row: Row) -> tuple[int, bool, int]:
        return order.index(row.method), row.view != "oblique", sum(row.object == other.object for other in found)

    for reason in sorted({row.reason for row in planned}, key=lambda text: (text != HELD, HELD not in text, text)):
        found.append(min((row for row in planned if row.reason == reason), key=rank))  # noqa: PERF401  `rank` reads it
    return found


def _draw_case(axes: tuple[Any, Any], row: Row, task: Task) -> None:
    seen = see(task.item, row.pose, row.view, task.cache)
    planner = Planner(row.method, task.settings)
    target = find(seen, planner.pipeline)
    proposal = planner.propose(seen, target)
    if target is None or proposal.contacts is None:
        return
    surface, points = Placed(task.item, seen.pose), seen.camera.to_world(target.cloud.xyz.astype(np.float64))
    g1, g2 = proposal.contacts
    level = (g2 - g1) * [1.0, 1.0, 0.0]
    if np.linalg.norm(level) < 0.2 * np.linalg.norm(g2 - g1):
        level = np.array([1.0, 0.0, 0.0])
    level /= np.linalg.norm(level)
    beside, up = np.cross([0.0, 0.0, 1.0], level), np.array([0.0, 0.0, 1.0])
    reason = row.reason.replace(f"{HELD}, ", f"{HELD}, but ")
    axes[0].set_title(f"{reason}\n{row.object}, {row.method}, {row.view}", fontsize=9)
    for axis, frame, name in (
        (axes[0], (level, up, beside), "from the side"),
        (axes[1], (level, beside, up), "from above"),
    ):
        _draw_view(axis, np.stack(frame), surface, points, proposal.contacts, row.tip_mm)
        axis.text(0.02, 0.02, name, transform=axis.transAxes, fontsize=8)
        axis.text(0.98, 0.02, "20 mm", transform=axis.transAxes, fontsize=8, ha="right")
        if name == "from the side":
            axis.axhline(-1e3 * float((proposal.contacts.mean(axis=0))[2]), color="sienna", linewidth=2)


def _draw_view(axis: Any, frame: Float64, surface: Placed, points: Float64, contacts: Float64, tip_mm: float) -> None:
    """One view; `frame` (3, 3) has right, up and the direction of view as rows; its origin is the middle of the contacts."""
    import trimesh
    from matplotlib.collections import LineCollection, PolyCollection

    origin = contacts.mean(axis=0)

    def flat(xyz: Float64) -> Float64:
        return np.asarray(1e3 * ((xyz - origin) @ frame[:2].T), np.float64)

    axis.add_collection(PolyCollection(flat(surface.mesh.triangles), facecolors="0.9", edgecolors="0.9"))
    cut = trimesh.intersections.mesh_plane(surface.mesh, frame[2], origin)
    if len(cut):
        axis.add_collection(LineCollection(flat(cut), colors="black", linewidths=1.2))
    near = np.abs((points - origin) @ frame[2]) < _SLICE_M
    for chosen, size, alpha in ((~near, 1.0, 0.15), (near, 3.0, 0.9)):
        axis.scatter(*flat(points[chosen]).T, s=size, alpha=alpha, color="tab:orange", linewidths=0)
    axis.plot(*flat(contacts).T, "x--", color="tab:red", markersize=7, markeredgewidth=2, linewidth=1)
    _draw_tips(axis, flat, surface, contacts, tip_mm)
    ends = np.concatenate([flat(surface.mesh.vertices), *(flat(contacts) + np.array([x, 0.0]) for x in (-45.0, 45.0))])
    middle, half = (ends.max(axis=0) + ends.min(axis=0)) / 2.0, float(np.ptp(ends, axis=0).max()) / 2.0 + 8.0
    axis.set_xlim(middle[0] - half, middle[0] + half)
    axis.set_ylim(middle[1] - half, middle[1] + half)
    low, right = middle[1] - 0.88 * half, middle[0] + 0.95 * half
    axis.plot([right - 20.0, right], [low, low], color="black", linewidth=2)
    axis.set_aspect("equal")


def _draw_tips(axis: Any, flat: Any, surface: Placed, contacts: Float64, tip_mm: float) -> None:
    from matplotlib.patches import Circle

    found = analytic.meet(surface, contacts[:1], contacts[1:])
    for k in range(2):
        start, closing, point, normal = (
            field[0, k] for field in (found.starts, found.closing, found.points, found.normals)
        )
        axis.add_patch(Circle(flat(start), tip_mm, fill=False, linestyle=":", color="tab:blue"))
        if np.isfinite(point).all():
            axis.add_patch(
                Circle(flat(point - 1e-3 * tip_mm * closing), tip_mm, fill=False, color="tab:blue", linewidth=1.5)
            )
            tail = flat(point)
            tip = flat(point - 1e-3 * _ARROW_MM * normal)
            axis.annotate("", tip, tail, arrowprops={"arrowstyle": "->", "color": "tab:green", "linewidth": 1.8})
