# SPDX-License-Identifier: Apache-2.0
"""Rows of `noise_ceiling` as skills with intervals, by bootstrap over the grasps that were repeated.

The intervals speak of other grasps of the same objects in the same scene. Ceiling and predictors share the draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.noise_ceiling.repeats import STRANGER
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.tactile.ranges import P2_RANGES
from foretouch.types import Float64

__all__ = ["CEILING", "ceiling_rows", "ceiling_tables"]

CEILING: Final = "ceiling"
WITH_TARE: Final = "ceiling, change from the tare"
NEVER_TOUCHED: Final = "ceiling, object never touched"
NEVER_TOUCHED_WITH_TARE: Final = "ceiling, object never touched, change from the tare"
_TAIL: Final = 0.025
_SEED: Final = 0


def ceiling_rows(rows: Sequence[Row], draws: int) -> list[Row]:
    """The rows of `results.csv`: a modality each, of the ceilings, of each cause alone and of each predictor.

    Args:
        rows: Of the cells. A predictor whose cell failed is not told of.
        draws: Of the bootstrap.
    """
    causes: dict[str, list[Row]] = {}
    for row in rows:
        if row["what"] == "repeats":
            causes.setdefault(row["name"], []).append(row)
    everything, strange = causes.pop("all", []), causes.pop(STRANGER, [])
    if not everything:
        return []
    reference = _table(everything, "reference")
    result = _told(CEILING, _table(everything, "within"), reference, draws)
    result += _told(WITH_TARE, _table(everything, "within_change"), reference, draws)
    if strange:
        own = _table(strange, "reference")
        result += _told(NEVER_TOUCHED, _table(strange, "within"), own, draws)
        result += _told(NEVER_TOUCHED_WITH_TARE, _table(strange, "within_change"), own, draws)
    known = {row["id"]: row["reference"] for row in everything}
    for cause, mine in causes.items():
        if all(row["id"] in known for row in mine):
            same = np.array([known[row["id"]] for row in mine])
            result += _told(f"only {cause} hidden", _table(mine, "within"), same, draws)
    return result + _predictor_rows(rows, strange or everything, draws)


def _predictor_rows(rows: Sequence[Row], repeated: Sequence[Row], draws: int) -> list[Row]:
    """Of each predictor, asked about what was repeated."""
    reference, ceiling = _table(repeated, "reference"), _table(repeated, "within")
    result: list[Row] = []
    asked = [row for row in rows if row["what"] == "predictor"]
    for name in dict.fromkeys(row["name"] for row in asked):
        said = {row["id"]: row["predicted"] for row in asked if row["name"] == name}
        predicted = np.array([said[row["id"]] for row in repeated])
        squared = (predicted - _table(repeated, "mean")) ** 2 + _table(repeated, "rest")  # eq. 2
        result += _told(name, squared, reference, draws, ceiling)
    return result


def ceiling_tables(rows: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Skill of everything, and the predictors' shares of the ceiling."""
    notes = [
        "skill: 0 is the mean of the training labels; [95 % interval by bootstrap over grasps]",
        "only ... hidden: the ceiling if all else were known",
    ]
    skills = _body(rows, "skill")
    shares = _body([row for row in rows if row["share"] is not None], "share")
    title = f"noise ceiling: {rows[0]['grasps']} grasps"
    told = Table(title, ["skill", *MODALITIES], skills, notes)
    return [told, Table("what predictors tell of it", ["share", *MODALITIES], shares)] if shares else [told]


def _body(rows: Sequence[Mapping[str, Any]], column: str) -> list[list[str]]:
    body = []
    for name in dict.fromkeys(row["name"] for row in rows):
        mine = {row["modality"]: row for row in rows if row["name"] == name}
        body.append([name, *(_cell(mine[modality], column) for modality in MODALITIES)])
    return body


def _cell(row: Mapping[str, Any], column: str) -> str:
    return f"{row[column]:.2f} [{row[f'{column}_low']:.2f}, {row[f'{column}_high']:.2f}]"


def _table(rows: Sequence[Row], column: str) -> Float64:
    return np.array([row[column] for row in rows], np.float64)


def _told(name: str, squared: Float64, reference: Float64, draws: int, ceiling: Float64 | None = None) -> list[Row]:
    """One row a modality; with a ceiling also the share of it."""
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
