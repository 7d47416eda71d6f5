# SPDX-License-Identifier: Apache-2.0
"""Coverage of intervals over objects: the mean with its interval, how objects are spread round it, and each object.

The interval of the mean is by bootstrap over objects, its percentiles expanded as everywhere (`learning.comparison`). That
of a single object is Wilson's score interval (Wilson 1927) with its grasps as independent trials: exact in kind for one
value, and too wide for the mean of 24 electrodes, whose hits agree only in part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.real_grasps import EVERYTHING
from foretouch.learning.evaluation.comparison import BootstrapConfig, mean_over_objects
from foretouch.tactile.modalities import MODALITIES
from foretouch.types import Float64

__all__ = ["SIMULATED", "SOUGHT", "coverage_table", "coverage_tables", "wilson_interval"]

SIMULATED: Final = "simulated"
"""The ground that several divisions tell of."""

SOUGHT: Final = (0.85, 0.95)
"""Where the mean coverage of 90 % intervals has to lie."""

_CONDITION: Final = ("ground", "tare", "touches")
_OUTER: Final = (0.1, 0.9)  # quantiles over objects that the table tells


def coverage_table(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """The rows of `results.csv`, a modality each: of all objects of a condition together, then of each.

    Args:
        rows: Of `coverage_rows` with `ground` and `part`. An object that several parts met counts once, by its mean.
        config: Of the bootstrap.
    """
    result: list[Row] = []
    for condition in dict.fromkeys(tuple(row[name] for name in _CONDITION) for row in rows):
        mine = [row for row in rows if tuple(row[name] for name in _CONDITION) == condition]
        head = dict(zip(_CONDITION, condition, strict=True))
        names = sorted({row["object"] for row in mine})
        coverage, width, unfamiliar = (_means(mine, names, column) for column in ("coverage", "width", "unfamiliar"))
        grasps = _counts(mine, names)
        for k, modality in enumerate(MODALITIES):
            result.append(
                {**head, "object": EVERYTHING, "modality": modality, "objects": len(names), "grasps": int(grasps.sum())}
                | _together(coverage[:, k], config)
                | {"width": _rounded(width[:, k].mean()), "unfamiliar": _rounded(unfamiliar.mean())}
            )
        for place, name in enumerate(names):
            for k, modality in enumerate(MODALITIES):
                low, high = wilson_interval(float(coverage[place, k]), int(grasps[place]), config.level)
                ends = {"low": _rounded(low), "high": _rounded(high), "objects_low": None, "objects_high": None}
                result.append(
                    {**head, "object": name, "modality": modality, "objects": 1, "grasps": int(grasps[place])}
                    | {"coverage": _rounded(coverage[place, k]), **ends}
                    | {"width": _rounded(width[place, k]), "unfamiliar": _rounded(unfamiliar[place, 0])}
                )
    return result


def wilson_interval(share: float, trials: int, level: float) -> tuple[float, float]:
    """Wilson's interval of a share of independent trials.

    Args:
        share: In 0...1.
        trials: At least one.
        level: Such as 0.95.
    """
    from scipy.stats import norm

    z2 = float(norm.ppf((1.0 + level) / 2.0)) ** 2
    centre = (share + z2 / (2.0 * trials)) / (1.0 + z2 / trials)
    half = np.sqrt(z2 * (share * (1.0 - share) / trials + z2 / (4.0 * trials**2))) / (1.0 + z2 / trials)
    return max(0.0, centre - float(half)), min(1.0, centre + float(half))


def coverage_tables(rows: Sequence[Row]) -> list[Table]:
    """A table for each ground: coverage and width of each condition, and which real objects are covered least."""
    together = [row for row in rows if row["object"] == EVERYTHING]
    tables = []
    for ground in dict.fromkeys(row["ground"] for row in together):
        mine = [row for row in together if row["ground"] == ground]
        body = [
            [label, *(_cell(row) for row in group)]
            for label, group in _grouped(mine, lambda row: _condition_label(row["tare"], row["touches"]))
        ]
        title = f"{ground}: {mine[0]['objects']} objects, {100.0 * mine[0]['unfamiliar']:.0f} % of grasps flagged"
        tables.append(Table(title, ["coverage / width", *MODALITIES], body))
    real = [row for row in rows if row["object"] != EVERYTHING and row["ground"] != SIMULATED and not row["touches"]]
    for ground in dict.fromkeys(row["ground"] for row in real):
        mine = [row for row in real if row["ground"] == ground]
        body = [
            [name, *(_own_cell(row) for row in group), f"{100.0 * group[0]['unfamiliar']:.0f} %"]
            for name, group in _grouped(mine, lambda row: row["object"])
        ]
        tables.append(Table(f"{ground}, no touch: each object", ["coverage", *MODALITIES, "flagged"], body))
    notes = [
        "mean over objects [95 % interval over objects] / width over that of the calibrated mean of the labels",
        f"☒: the mean lies outside of {SOUGHT[0]:.2f} to {SOUGHT[1]:.2f}",
        "of a single object: Wilson's interval with its grasps as trials",
    ]
    last = tables[-1]
    return [*tables[:-1], Table(last.title, last.columns, last.rows, notes)]


def _means(rows: Sequence[Row], names: Sequence[str], column: str) -> Float64:
    """(objects, 1 or 4): the mean of an object's rows."""
    return np.array(
        [np.mean([np.atleast_1d(r[column]) for r in rows if r["object"] == name], axis=0) for name in names]
    )


def _counts(rows: Sequence[Row], names: Sequence[str]) -> npt.NDArray[np.int_]:
    """(objects,) grasps: divisions of simulated objects meet the same ones, other parts each their own."""
    counts = [[row["grasps"] for row in rows if row["object"] == name] for name in names]
    return np.array([max(mine) if rows[0]["ground"] == SIMULATED else sum(mine) for mine in counts])


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
    sign = "" if SOUGHT[0] <= row["coverage"] <= SOUGHT[1] else " ☒"
    ends = "" if row["low"] is None else f" [{row['low']:.2f}, {row['high']:.2f}]"
    return f"{row['coverage']:.3f}{sign}{ends} / {row['width']:.2f}"


def _own_cell(row: Row) -> str:
    return f"{row['coverage']:.2f} [{row['low']:.2f}, {row['high']:.2f}]"
