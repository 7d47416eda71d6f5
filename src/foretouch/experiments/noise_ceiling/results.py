# SPDX-License-Identifier: Apache-2.0
"""Skills of `noise_ceiling` with intervals, by bootstrap over the repeated grasps, as rows, tables and figure.

The intervals are for other grasps of the same objects in the same scene. Ceiling and predictors share the draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.noise_ceiling.repeats import NEW_OBJECT
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES, P2_RANGES, columns
from foretouch.types import Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes


CEILING: Final = "ceiling"
WITH_TARE: Final = "ceiling, change from the tare"
NEVER_TOUCHED: Final = "ceiling, object never touched"
NEVER_TOUCHED_WITH_TARE: Final = "ceiling, object never touched, change from the tare"
_TAIL: Final = 0.025
_SEED: Final = 0


def ceiling_rows(rows: Sequence[Row], draws: int) -> list[Row]:
    """Rows of `results.csv`: one per modality for each ceiling, each cause alone and each predictor.

    Args:
        rows: Rows of the cells. A predictor whose cell failed is left out.
        draws: Number of bootstrap samples.
    """
    causes: dict[str, list[Row]] = {}
    for row in rows:
        if row["what"] == "repeats":
            causes.setdefault(row["name"], []).append(row)
    all_hidden, new_object = causes.pop("all", []), causes.pop(NEW_OBJECT, [])
    if not all_hidden:
        return []
    reference = _table(all_hidden, "reference")
    result = _score(CEILING, _table(all_hidden, "within"), reference, draws)
    result += _score(WITH_TARE, _table(all_hidden, "within_change"), reference, draws)
    if new_object:
        own = _table(new_object, "reference")
        result += _score(NEVER_TOUCHED, _table(new_object, "within"), own, draws)
        result += _score(NEVER_TOUCHED_WITH_TARE, _table(new_object, "within_change"), own, draws)
    known = {row["id"]: row["reference"] for row in all_hidden}
    for cause, repeated in causes.items():
        if all(row["id"] in known for row in repeated):
            same = np.array([known[row["id"]] for row in repeated])
            result += _score(f"only {cause} hidden", _table(repeated, "within"), same, draws)
    return result + _predictor_rows(rows, new_object or all_hidden, draws)


def _predictor_rows(rows: Sequence[Row], repeated: Sequence[Row], draws: int) -> list[Row]:
    """Scores of each predictor on the repeated grasps."""
    reference, ceiling = _table(repeated, "reference"), _table(repeated, "within")
    result: list[Row] = []
    predictions = [row for row in rows if row["what"] == "predictor"]
    for name in dict.fromkeys(row["name"] for row in predictions):
        by_id = {row["id"]: row["predicted"] for row in predictions if row["name"] == name}
        predicted = np.array([by_id[row["id"]] for row in repeated])
        squared = (predicted - _table(repeated, "mean")) ** 2 + _table(repeated, "rest")  # eq. 2
        result += _score(name, squared, reference, draws, ceiling)
    return result


def ceiling_tables(rows: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Skills, and the predictors' shares of the ceiling."""
    notes = [
        "skill: 0 is the mean of the training labels; [95 % interval by bootstrap over grasps]",
        "only ... hidden: the ceiling if all other causes were known",
    ]
    skills = _body(rows, "skill")
    shares = _body([row for row in rows if row["share"] is not None], "share")
    title = f"noise ceiling: {rows[0]['grasps']} grasps"
    table = Table(title, ["skill", *MODALITIES], skills, notes)
    return [table, Table("share of the ceiling", ["share", *MODALITIES], shares)] if shares else [table]


def _body(rows: Sequence[Mapping[str, Any]], column: str) -> list[list[str]]:
    body = []
    for name in dict.fromkeys(row["name"] for row in rows):
        subset = {row["modality"]: row for row in rows if row["name"] == name}
        body.append([name, *(_cell(subset[modality], column) for modality in MODALITIES)])
    return body


def _cell(row: Mapping[str, Any], column: str) -> str:
    return f"{row[column]:.2f} [{row[f'{column}_low']:.2f}, {row[f'{column}_high']:.2f}]"


def _table(rows: Sequence[Row], column: str) -> Float64:
    return np.array([row[column] for row in rows], np.float64)


def _score(name: str, squared: Float64, reference: Float64, draws: int, ceiling: Float64 | None = None) -> list[Row]:
    """One row per modality; with a ceiling also the share of it."""
    size = len(squared)
    weights = np.random.default_rng(_SEED).multinomial(size, np.full(size, 1.0 / size), draws).astype(np.float64)
    weights = np.vstack([np.ones(size), weights])
    skill = _skills(squared, reference, weights)
    share = None if ceiling is None else skill / _skills(ceiling, reference, weights)
    rows = []
    for k, modality in enumerate(MODALITIES):
        rmse = float(np.sqrt(squared[:, columns([modality])].mean()))
        low, high = P2_RANGES.of(modality)
        row = {"name": name, "modality": modality, "grasps": size, "rmse": round(rmse, 3)}
        row["nrmse_p2"] = round(rmse / (high - low), 6)
        row |= _ends("skill", skill[:, k]) | _ends("share", None if share is None else share[:, k])
        rows.append(row)
    return rows


def _skills(squared: Float64, reference: Float64, weights: Float64) -> Float64:
    """(draws, 4): 1 - sum S / sum R per value, averaged over the modality's values."""
    per_value = 1.0 - (weights @ squared) / (weights @ reference)
    return np.stack([per_value[:, columns([name])].mean(axis=1) for name in MODALITIES], axis=1)


def _ends(column: str, drawn: Float64 | None) -> Row:
    if drawn is None:
        return dict.fromkeys((column, f"{column}_low", f"{column}_high"))
    low, high = np.quantile(drawn[1:], [_TAIL, 1.0 - _TAIL])
    return {
        column: round(float(drawn[0]), 6),
        f"{column}_low": round(float(low), 6),
        f"{column}_high": round(float(high), 6),
    }


def draw_ceiling_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `ceiling.png`: modalities side by side."""
    names = list(dict.fromkeys(row["name"] for row in rows))
    figure = new_figure(13.0, 1.2 + 0.35 * len(names))
    panels = figure.subplots(1, len(MODALITIES), sharey=True, sharex=True)
    for axes, modality in zip(panels, MODALITIES, strict=True):
        draw_ceiling(axes, [row for row in rows if row["modality"] == modality], names)
        axes.set_title(modality)
        axes.set_xlabel("skill (0: training mean)")
    panels[0].invert_yaxis()
    return [save(figure, folder / "ceiling.png")]


def draw_ceiling(axes: Axes, rows: Rows, names: Sequence[str]) -> None:
    """Draw skill and interval of each row, one below the other; with the share of the ceiling of predictors."""
    for row in rows:
        y = names.index(row["name"])
        colour = "C0" if row["share"] is None else "C1"
        axes.barh(y, max(row["skill"], 0.0), color=colour, alpha=0.5)
        axes.plot([row["skill_low"], row["skill_high"]], [y, y], color=colour)
        if row["share"] is not None:
            axes.annotate(f"{100.0 * row['share']:.0f} %", (1.0, y), ha="right", va="center", fontsize=8)
    axes.set_xlim(0.0, 1.02)
    axes.set_yticks(range(len(names)), names)
    axes.grid(visible=True, axis="x", alpha=0.3)
