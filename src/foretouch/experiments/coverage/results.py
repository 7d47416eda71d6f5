# SPDX-License-Identifier: Apache-2.0
"""Coverage of intervals over objects as rows, tables and figure: mean with interval, spread, and each object.

The interval of the mean is by bootstrap over objects with expanded percentiles, as everywhere
(`learning.evaluation.metrics`). That of a single object is Wilson's score interval (Wilson 1927) with its grasps as
independent trials: appropriate for one value, and too wide for the mean of 24 electrodes, whose errors are correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.figures import draw_series
from foretouch.experiments.shared.rows import grouped, select, short, span, unique
from foretouch.experiments.shared.scores import ALL_OBJECTS
from foretouch.experiments.shared.skill_tables import findings
from foretouch.learning.evaluation.metrics import BootstrapConfig, mean_over_objects
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIMULATED: Final = "simulated"
"""Condition with several random splits, in which an object may be tested more than once."""

_NOMINAL: Final = 0.9
_ACCEPTED: Final = (0.85, 0.95)  # range in which the mean coverage must lie
_CONDITION: Final = ("condition", "tare", "touches")
_OUTER: Final = (0.1, 0.9)  # quantiles over objects


def coverage_table(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, one per modality: for all objects of a condition together, then for each object.

    Args:
        rows: Rows of `coverage_rows` with `condition` and `part`. An object of several parts counts once, by its mean.
        config: Configuration of the bootstrap.
    """
    result: list[Row] = []
    for condition, chosen in grouped(rows, *_CONDITION):
        head = dict(zip(_CONDITION, condition, strict=True))
        objects = [(name, _mean_of(own)) for name, own in sorted(grouped(chosen, "object"))]
        for k, modality in enumerate(MODALITIES):
            coverage = np.array([own["coverage"][k] for _, own in objects])
            estimate = mean_over_objects(coverage, config)
            ends = {"coverage": estimate.value, "low": estimate.low, "high": estimate.high}
            ends |= dict(zip(("objects_low", "objects_high"), np.quantile(coverage, _OUTER), strict=True))
            counts = {"objects": len(objects), "grasps": sum(own["grasps"] for _, own in objects)}
            means = {
                "width": np.mean([own["width"][k] for _, own in objects]),
                "unfamiliar": np.mean([own["unfamiliar"] for _, own in objects]),
            }
            result.append({**head, "object": ALL_OBJECTS, "modality": modality, **counts, **ends, **means})
        for name, own in objects:
            for k, modality in enumerate(MODALITIES):
                low, high = wilson_interval(own["coverage"][k], own["grasps"], config.level)
                ends = {"coverage": own["coverage"][k], "low": low, "high": high}
                ends |= {"objects_low": None, "objects_high": None}
                counts = {"objects": 1, "grasps": own["grasps"]}
                means = {"width": own["width"][k], "unfamiliar": own["unfamiliar"]}
                result.append({**head, "object": name, "modality": modality, **counts, **ends, **means})
    return result


def _mean_of(rows: Sequence[Row]) -> Row:
    """Means of one object's rows; random splits of simulated objects repeat its grasps, other parts have their own."""
    means: Row = {name: np.mean([row[name] for row in rows], axis=0) for name in ("coverage", "width", "unfamiliar")}
    count = max if rows[0]["condition"] == SIMULATED else sum
    return {**means, "grasps": count(row["grasps"] for row in rows)}


def wilson_interval(share: float, trials: int, level: float) -> tuple[float, float]:
    """Wilson's confidence interval of a share of at least one independent trials, such as at the level 0.95."""
    from scipy.stats import norm

    z2 = float(norm.ppf((1.0 + level) / 2.0)) ** 2
    centre = (share + z2 / (2.0 * trials)) / (1.0 + z2 / trials)
    half = np.sqrt(z2 * (share * (1.0 - share) / trials + z2 / (4.0 * trials**2))) / (1.0 + z2 / trials)
    return max(0.0, centre - float(half)), min(1.0, centre + float(half))


def coverage_tables(rows: Sequence[Row]) -> list[Table]:
    """A table of coverage and width for each condition, and one of the coverage of each real object."""
    sentences, tables = [], []
    for condition, own in grouped(rows, "condition"):
        together = select(own, object=ALL_OBJECTS)
        body = [[_label(*key), *map(_cell, found)] for key, found in grouped(together, "tare", "touches")]
        flagged = f"{100.0 * together[0]['unfamiliar']:.0f} % of grasps flagged"
        title = f"{condition}: {together[0]['objects']} objects, {flagged}"
        tables.append(Table(title, ["coverage / width", *MODALITIES], body))
        single = [row for row in own if row["object"] != ALL_OBJECTS]
        lowest = min(single, key=lambda row: row["coverage"])
        sentences.append(
            f"{condition}: coverage is {span(row['coverage'] for row in together)} on average; the lowest of one object is "
            f"{short(lowest['coverage'])} ({lowest['object']}, {lowest['modality']}, {_label(lowest['tare'], lowest['touches'])})"
        )
    real = [
        row for row in rows if row["object"] != ALL_OBJECTS and row["condition"] != SIMULATED and not row["touches"]
    ]
    for condition, own in grouped(real, "condition"):
        body = [
            [name, *map(_own_cell, found), f"{100.0 * found[0]['unfamiliar']:.0f} %"]
            for name, found in grouped(own, "object")
        ]
        tables.append(Table(f"{condition}, no touch: each object", ["coverage", *MODALITIES, "flagged"], body))
    notes = [
        "mean over objects [95 % interval over objects] / interval width relative to that of the calibrated label mean",
        f"☒: the mean lies outside {_ACCEPTED[0]:.2f} to {_ACCEPTED[1]:.2f}",
        "single objects: Wilson's interval with the grasps as trials",
    ]
    return [findings(sentences), *tables[:-1], replace(tables[-1], notes=notes)]


def _label(tare: bool, touches: int) -> str:
    touched = {0: "no touch", 1: "1 touch"}.get(touches, f"{touches} touches")
    return f"tare, {touched}" if tare else touched


def _cell(row: Row) -> str:
    sign = "" if _ACCEPTED[0] <= row["coverage"] <= _ACCEPTED[1] else " ☒"
    ends = "" if row["low"] is None else f" [{row['low']:.2f}, {row['high']:.2f}]"
    return f"{row['coverage']:.3f}{sign}{ends} / {row['width']:.2f}"


def _own_cell(row: Row) -> str:
    return f"{row['coverage']:.2f} [{row['low']:.2f}, {row['high']:.2f}]"


def draw_coverage_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `coverage.png`: a line of panels for each condition, with and without tare: modalities, then widths."""
    conditions = grouped(rows, "condition", "tare")
    figure = new_figure(16.0, 0.6 + 2.5 * len(conditions))
    grid = figure.subplots(len(conditions), len(MODALITIES) + 1, squeeze=False)
    for line, ((condition, tare), own) in zip(grid, conditions, strict=True):
        for axes, modality in zip(line, MODALITIES, strict=False):
            draw_coverage(axes, select(own, modality=modality))
            axes.set_title(modality, fontsize=10)
        line[0].set_ylabel(f"{condition}{', tare' if tare else ''}\ncoverage")
        together = select(own, object=ALL_OBJECTS)
        draw_series(line[-1], together, "touches", "modality", MODALITIES, values="width")
        line[-1].axhline(1.0, color="grey", linewidth=0.8)
        line[-1].set_ylim(0.0, max(1.1, *(1.05 * row["width"] for row in together)))
        line[-1].set_title("width relative to label-mean interval", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("touches")
    grid[0, -1].legend(fontsize=7, loc="lower left")
    return [save(figure, folder / "coverage.png")]


def draw_coverage(axes: Axes, rows: Rows) -> None:
    """Draw one modality over touches: a dot per object, the mean with its interval, and the accepted range."""
    counts = sorted(set(unique(rows, "touches")))
    axes.axhspan(*_ACCEPTED, color="C2", alpha=0.15)
    axes.axhline(_NOMINAL, color="C2", linewidth=1.0)
    for x, count in enumerate(counts):
        own = select(rows, touches=count)
        dots = sorted(row["coverage"] for row in own if row["object"] != ALL_OBJECTS)
        axes.plot(
            [x - 0.3 + 0.4 * k / max(len(dots) - 1, 1) for k in range(len(dots))], dots, ".C0", markersize=4, alpha=0.6
        )
        for row in select(own, object=ALL_OBJECTS):
            axes.plot(x + 0.25, row["coverage"], "ok", markersize=5)
            if row["low"] is not None:
                axes.plot([x + 0.25] * 2, [row["low"], row["high"]], color="k")
    axes.set_ylim(min(0.4, *(row["coverage"] for row in rows)) - 0.02, 1.02)
    axes.set_xlim(-0.5, len(counts) - 0.5)
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, axis="y", alpha=0.3)
