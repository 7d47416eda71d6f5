# SPDX-License-Identifier: Apache-2.0
"""What one more hour of the robot or of the computer buys: sentences and a figure from `tradeoff.csv`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from foretouch.experiments.framework.experiment import Row
from foretouch.report.panels import new_figure, save
from foretouch.tradeoff.areas.training.measures import ONE_BLOCK
from foretouch.tradeoff.areas.training.variants import CONTACT, NETWORK
from foretouch.tradeoff.frontier import of_request

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROBOT: Final = {
    "labels": ("known", "known objects, more grasps of each"),
    "objects": ("new", "new objects, more objects"),
}
"""Factors that cost time of the robot, with the column of the skill and what is said about it."""

_COMPUTER: Final = {"trees": ("known", CONTACT), "epochs": (ONE_BLOCK, NETWORK), "cloud size": (ONE_BLOCK, NETWORK)}
"""Factors that cost time of the computer, with the column of the skill and the variant in which they are as shipped."""


def notes(rows: Sequence[Row]) -> list[str]:
    """Sentences about steps from less to more."""
    rows = of_request(rows, 1)
    return [*_robot_notes(rows), *_computer_notes(rows)]


def _robot_notes(rows: Sequence[Row]) -> Iterator[str]:
    for factor, (column, text) in _ROBOT.items():
        for less, more in pairwise(_series(rows, factor, column, f"robot_h_{column}", CONTACT)):
            hours = more[f"robot_h_{column}"] - less[f"robot_h_{column}"]
            gain = more[column] - less[column]
            each = f": {gain / hours:+.3f} an hour" if hours > 0.0 else ""
            yield (
                f"Robot, {text}: from {less[f'grasps_{column}']} to {more[f'grasps_{column}']} grasps, {hours:.1f} hours, "
                f"skill {less[column]:.3f} to {more[column]:.3f}{each}."
            )


def _computer_notes(rows: Sequence[Row]) -> Iterator[str]:
    for factor, (column, shipped) in _COMPUTER.items():
        for less, more in pairwise(_series(rows, factor, column, "cpu_ms", shipped)):
            seconds = 1e-3 * (more["cpu_ms"] - less["cpu_ms"])
            yield (
                f"Computer, {factor}: from {less['variant']} to {more['variant']}, {seconds:.1f} s more of one core, skill "
                f"{less[column]:.3f} to {more[column]:.3f}."
            )


def _series(rows: Sequence[Row], factor: str, column: str, order: str, shipped: str) -> list[Row]:
    """Rows of one factor and the shipped one, by what they cost."""
    own = [row for row in rows if (row["factor"] == factor or row["variant"] == shipped) and row[column] is not None]
    own = [row for row in own if row[order] is not None]
    return sorted(own, key=lambda row: row[order]) if len(own) > 1 else []


def draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw `labels.png`: skill over the hours of the robot, of known and of new objects."""
    rows = of_request(rows, 1)
    panels = [
        (column, text, series)
        for factor, (column, text) in _ROBOT.items()
        if (series := _series(rows, factor, column, f"robot_h_{column}", CONTACT))
    ]
    if not panels:
        return []
    figure = new_figure(5.6 * len(panels), 3.6)
    for axes, (column, text, series) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        _draw_series(axes, column, text, series)
    return [save(figure, folder / "labels.png")]


def _draw_series(axes: Axes, column: str, text: str, series: Sequence[Row]) -> None:
    hours = any(row[f"robot_h_{column}"] for row in series)
    across: list[Any] = [row[f"robot_h_{column}" if hours else f"grasps_{column}"] for row in series]
    axes.plot(across, [row[column] for row in series], marker="o")
    for x, row in zip(across, series, strict=True):
        if row[f"{column}_low"] is not None:
            axes.plot([x, x], [row[f"{column}_low"], row[f"{column}_high"]], color="C0", linewidth=1)
        axes.annotate(
            f"{row[f'grasps_{column}']}", (x, row[column]), xytext=(5, -11), textcoords="offset points", fontsize=8
        )
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_xlabel("hours of the robot; beside the points: training grasps" if hours else "training grasps")
    axes.set_ylabel("mean skill, 95 % interval")
    axes.set_title(text, fontsize=10)
    axes.margins(x=0.1)
    axes.grid(visible=True, alpha=0.3)
