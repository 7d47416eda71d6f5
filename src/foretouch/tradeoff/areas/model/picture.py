# SPDX-License-Identifier: Apache-2.0
"""The picture that answers how good a prediction a robot can have in 10 ms, for 1 to 1000 grasps at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from foretouch.experiments.framework.experiment import Row
from foretouch.report.panels import new_figure
from foretouch.tradeoff.frontier import frontier, of_request, time_column
from foretouch.tradeoff.picture import save_small, spread

_BUDGET_MS: Final = 10.0
_SKILL: Final = "time"
_APART: Final = 0.045  # of the labels, as a share of the axes


def draw_overview(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw `ten_milliseconds.png`: the frontier for each number of grasps, what each leaves in 10 ms, and the default."""
    requests = sorted({row["request"] for row in rows})
    lines = {request: frontier(of_request(rows, request), _SKILL) for request in requests}
    names = {row["variant"]: row[_SKILL] for line in lines.values() for row in line}
    if not names:
        return []
    figure = new_figure(10.0, 5.2)
    axes = figure.subplots()
    column = time_column(of_request(rows, requests[0]))
    axes.axvline(_BUDGET_MS, color="black", linewidth=1.2)
    for number, (request, line) in enumerate(lines.items()):
        times, skills = [row[column] for row in line], [row[_SKILL] for row in line]
        within = [row for row in line if row[column] <= _BUDGET_MS]
        best = f"; in {_BUDGET_MS:g} ms {within[-1][_SKILL]:.2f}: {within[-1]['variant']}" if within else ""
        label = f"{request} grasp{'s' * (request > 1)}{best}"
        axes.step(times, skills, where="post", marker="o", markersize=4, linewidth=1.2, color=f"C{number}", label=label)
        for row in of_request(rows, request):
            if row["factor"] == "shipped":
                axes.plot(row[column], row[_SKILL], marker="*", markersize=12, color=f"C{number}", zorder=3)
                names[f"★ {row['variant']}, the default"] = row[_SKILL]
    axes.set_xscale("log")
    axes.set_xlabel(
        "time of a prediction [ms], "
        + ("wall time, idle machine" if column == "ms_p50" else "processor time, loaded machine")
    )
    axes.set_ylabel("mean skill on later grasps of known objects\n(0: mean of the labels, 1: perfect)")
    axes.grid(visible=True, which="major", alpha=0.25)
    low, high = axes.get_ylim()
    ordered = sorted(names, key=lambda name: names[name])
    places = spread([(names[name] - low) / (high - low) for name in ordered], _APART)
    for name, place in zip(ordered, places, strict=True):
        axes.annotate(
            name, (1.0, (names[name] - low) / (high - low)), (1.03, place), xycoords="axes fraction",
            textcoords="axes fraction", va="center", fontsize=8, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": "grey", "shrinkA": 0, "shrinkB": 0, "relpos": (0.0, 0.5)},
        )  # fmt: skip
    axes.legend(loc="center left", fontsize=8, title="frontier for")
    return [save_small(figure, folder / "ten_milliseconds.png")]
