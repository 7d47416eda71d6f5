# SPDX-License-Identifier: Apache-2.0
"""Coverage of intervals over objects as rows, tables and figure: mean with interval, spread, and each object.

The interval of the mean is by bootstrap over objects with expanded percentiles, as everywhere
(`learning.evaluation.comparison`). That of a single object is Wilson's score interval (Wilson 1927) with its grasps as
independent trials: appropriate for one value, and too wide for the mean of 24 electrodes, whose errors are correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.scores import ALL_OBJECTS
from foretouch.learning.evaluation.metrics import BootstrapConfig, mean_over_objects
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES
from foretouch.types import Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SIMULATED: Final = "simulated"
"""Ground with several random splits, in which an object may be tested more than once."""

NOMINAL: Final = 0.9
ACCEPTED: Final = (0.85, 0.95)
"""Nominal coverage, and the range in which the mean coverage must lie."""

_CONDITION: Final = ("ground", "tare", "touches")
_OUTER: Final = (0.1, 0.9)  # quantiles over objects in the table


def coverage_table(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, one per modality: for all objects of a condition together, then for each object.

    Args:
        rows: Rows of `coverage_rows` with `ground` and `part`. An object of several parts counts once, by its mean.
        config: Configuration of the bootstrap.
    """
    result: list[Row] = []
    for condition in dict.fromkeys(tuple(row[name] for name in _CONDITION) for row in rows):
        chosen = [row for row in rows if tuple(row[name] for name in _CONDITION) == condition]
        head = dict(zip(_CONDITION, condition, strict=True))
        names = sorted({row["object"] for row in chosen})
        coverage, width, unfamiliar = (_means(chosen, names, column) for column in ("coverage", "width", "unfamiliar"))
        grasps = _counts(chosen, names)
        for k, modality in enumerate(MODALITIES):
            result.append(
                {
                    **head,
                    "object": ALL_OBJECTS,
                    "modality": modality,
                    "objects": len(names),
                    "grasps": int(grasps.sum()),
                }
                | _together(coverage[:, k], config)
                | {"width": _rounded(width[:, k].mean()), "unfamiliar": _rounded(unfamiliar.mean())}
            )
        for k_object, name in enumerate(names):
            for k, modality in enumerate(MODALITIES):
                low, high = wilson_interval(float(coverage[k_object, k]), int(grasps[k_object]), config.level)
                ends = {"low": _rounded(low), "high": _rounded(high), "objects_low": None, "objects_high": None}
                result.append(
                    {**head, "object": name, "modality": modality, "objects": 1, "grasps": int(grasps[k_object])}
                    | {"coverage": _rounded(coverage[k_object, k]), **ends}
                    | {"width": _rounded(width[k_object, k]), "unfamiliar": _rounded(unfamiliar[k_object, 0])}
                )
    return result


def wilson_interval(share: float, trials: int, level: float) -> tuple[float, float]:
    """Wilson's confidence interval of a share of at least one independent trials, such as at the level 0.95."""
    from scipy.stats import norm

    z2 = float(norm.ppf((1.0 + level) / 2.0)) ** 2
    centre = (share + z2 / (2.0 * trials)) / (1.0 + z2 / trials)
    half = np.sqrt(z2 * (share * (1.0 - share) / trials + z2 / (4.0 * trials**2))) / (1.0 + z2 / trials)
    return max(0.0, centre - float(half)), min(1.0, centre + float(half))


def coverage_tables(rows: Sequence[Row]) -> list[Table]:
    """A table of coverage and width for each ground, and one of the coverage of each real object."""
    together = [row for row in rows if row["object"] == ALL_OBJECTS]
    tables = []
    for ground in dict.fromkeys(row["ground"] for row in together):
        subset = [row for row in together if row["ground"] == ground]
        body = [
            [label, *(_cell(row) for row in group)]
            for label, group in _grouped(subset, lambda row: _condition_label(row["tare"], row["touches"]))
        ]
        title = f"{ground}: {subset[0]['objects']} objects, {100.0 * subset[0]['unfamiliar']:.0f} % of grasps flagged"
        tables.append(Table(title, ["coverage / width", *MODALITIES], body))
    real = [row for row in rows if row["object"] != ALL_OBJECTS and row["ground"] != SIMULATED and not row["touches"]]
    for ground in dict.fromkeys(row["ground"] for row in real):
        subset = [row for row in real if row["ground"] == ground]
        body = [
            [name, *(_own_cell(row) for row in group), f"{100.0 * group[0]['unfamiliar']:.0f} %"]
            for name, group in _grouped(subset, lambda row: row["object"])
        ]
        tables.append(Table(f"{ground}, no touch: each object", ["coverage", *MODALITIES, "flagged"], body))
    notes = [
        "mean over objects [95 % interval over objects] / interval width relative to that of the calibrated label mean",
        f"☒: the mean lies outside {ACCEPTED[0]:.2f} to {ACCEPTED[1]:.2f}",
        "single objects: Wilson's interval with the grasps as trials",
    ]
    return [*tables[:-1], replace(tables[-1], notes=notes)]


def _means(rows: Sequence[Row], names: Sequence[str], column: str) -> Float64:
    """(objects, 1 or 4): mean of each object's rows."""
    return np.array(
        [np.mean([np.atleast_1d(r[column]) for r in rows if r["object"] == name], axis=0) for name in names]
    )


def _counts(rows: Sequence[Row], names: Sequence[str]) -> npt.NDArray[np.int_]:
    """(objects,) number of grasps: random splits of simulated objects repeat them, other parts have their own."""
    counts = [[row["grasps"] for row in rows if row["object"] == name] for name in names]
    return np.array([max(each) if rows[0]["ground"] == SIMULATED else sum(each) for each in counts])


def _together(coverage: Float64, config: BootstrapConfig) -> Row:
    estimate = mean_over_objects(coverage, config)
    low, high = np.quantile(coverage, _OUTER)
    return {
        "coverage": _rounded(estimate.value),
        "low": None if estimate.low is None else _rounded(estimate.low),
        "high": None if estimate.high is None else _rounded(estimate.high),
        "objects_low": _rounded(low),
        "objects_high": _rounded(high),
    }


def _rounded(value: Any) -> float:
    return round(float(value), 4)


def _grouped(rows: Sequence[Row], key: Any) -> list[tuple[str, list[Row]]]:
    return [(name, [row for row in rows if key(row) == name]) for name in dict.fromkeys(key(row) for row in rows)]


def _condition_label(tare: bool, touches: int) -> str:
    touched = {0: "no touch", 1: "1 touch"}.get(touches, f"{touches} touches")
    return f"tare, {touched}" if tare else touched


def _cell(row: Row) -> str:
    sign = "" if ACCEPTED[0] <= row["coverage"] <= ACCEPTED[1] else " ☒"
    ends = "" if row["low"] is None else f" [{row['low']:.2f}, {row['high']:.2f}]"
    return f"{row['coverage']:.3f}{sign}{ends} / {row['width']:.2f}"


def _own_cell(row: Row) -> str:
    return f"{row['coverage']:.2f} [{row['low']:.2f}, {row['high']:.2f}]"


def draw_coverage_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `coverage.png`: a line of panels for each ground, with and without tare: modalities, then widths."""
    grounds = list(dict.fromkeys((row["ground"], row["tare"]) for row in rows))
    figure = new_figure(16.0, 0.6 + 2.5 * len(grounds))
    grid = figure.subplots(len(grounds), len(MODALITIES) + 1, squeeze=False)
    for line, (ground, tare) in zip(grid, grounds, strict=True):
        subset = [row for row in rows if (row["ground"], row["tare"]) == (ground, tare)]
        for axes, modality in zip(line, MODALITIES, strict=False):
            draw_coverage(axes, [row for row in subset if row["modality"] == modality])
            axes.set_title(modality, fontsize=10)
        line[0].set_ylabel(f"{ground}{', tare' if tare else ''}\ncoverage")
        draw_widths(line[-1], [row for row in subset if row["object"] == ALL_OBJECTS])
        line[-1].set_title("width relative to label-mean interval", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("touches")
    grid[0, -1].legend(fontsize=7, loc="lower left")
    return [save(figure, folder / "coverage.png")]


def draw_coverage(axes: Axes, rows: Rows) -> None:
    """Draw one modality over touches: a dot per object, the mean with its interval, and the accepted range."""
    counts = sorted({row["touches"] for row in rows})
    axes.axhspan(*ACCEPTED, color="C2", alpha=0.15)
    axes.axhline(NOMINAL, color="C2", linewidth=1.0)
    for x, count in enumerate(counts):
        subset = [row for row in rows if row["touches"] == count]
        dots = sorted(row["coverage"] for row in subset if row["object"] != ALL_OBJECTS)
        spread = [x - 0.3 + 0.4 * k / max(len(dots) - 1, 1) for k in range(len(dots))]
        axes.plot(spread, dots, ".", color="C0", markersize=4, alpha=0.6)
        for row in subset:
            if row["object"] == ALL_OBJECTS:
                axes.plot(x + 0.25, row["coverage"], "o", color="k", markersize=5)
                if row["low"] is not None:
                    axes.plot([x + 0.25] * 2, [row["low"], row["high"]], color="k")
    axes.set_ylim(min(0.4, *(row["coverage"] for row in rows)) - 0.02, 1.02)
    axes.set_xlim(-0.5, len(counts) - 0.5)
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, axis="y", alpha=0.3)


def draw_widths(axes: Axes, rows: Rows) -> None:
    """Draw the widths of all objects together, a line for each modality."""
    counts = sorted({row["touches"] for row in rows})
    for number, modality in enumerate(MODALITIES):
        subset = sorted((row for row in rows if row["modality"] == modality), key=lambda row: row["touches"])
        x = [counts.index(row["touches"]) for row in subset]
        axes.plot(x, [row["width"] for row in subset], marker="o", color=f"C{number}", label=modality, markersize=4)
    axes.axhline(1.0, color="grey", linewidth=0.8)
    axes.set_ylim(0.0, max(1.1, *(1.05 * row["width"] for row in rows)))
    axes.set_xticks(range(len(counts)), [str(count) for count in counts])
    axes.grid(visible=True, alpha=0.3)
