# SPDX-License-Identifier: Apache-2.0
"""Rows of `noise_ceiling` as skills with intervals, by bootstrap over the grasps that were repeated.

The intervals speak of other grasps of the same objects in the same scene. Ceiling and predictors share the draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from foretouch.learning.experiments.experiment import Row, Table
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import Float64

__all__ = ["CEILING", "ceiling_rows", "ceiling_tables"]

CEILING: Final = "ceiling"
WITH_TARE: Final = "ceiling, change from the tare"
_TAIL: Final = 0.025
_SEED: Final = 0


def ceiling_rows(rows: Sequence[Row], draws: int) -> list[Row]:
    """The rows of `results.csv`: a modality each, of the ceiling, of each cause alone and of each predictor.

    Args:
        rows: Of the cells. A predictor whose cell failed is not told of.
        draws: Of the bootstrap.
    """
    repeated = [row for row in rows if row["what"] == "repeats"]
    everything = [row for row in repeated if row["name"] == "all"]
    if not everything:
        return []
    ceiling = _table(everything, "within")
    reference = _table(everything, "reference")
    result = _told(CEILING, ceiling, reference, draws)
    result += _told(WITH_TARE, _table(everything, "within_change"), reference, draws)
    for cause in dict.fromkeys(row["name"] for row in repeated if row["name"] != "all"):
        mine = [row for row in repeated if row["name"] == cause]
        place = {row["id"]: k for k, row in enumerate(everything)}
        same = reference[[place[row["id"]] for row in mine if row["id"] in place]]
        if len(same) == len(mine):
            result += _told(f"only {cause} hidden", _table(mine, "within"), same, draws)
    for name in dict.fromkeys(row["name"] for row in rows if row["what"] == "predictor"):
        predicted = {row["id"]: row["predicted"] for row in rows if row["what"] == "predictor" and row["name"] == name}
        asked = np.array([predicted[row["id"]] for row in everything])
        squared = (asked - _table(everything, "mean")) ** 2 + _table(everything, "rest")  # eq. 2
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
        row = {"name": name, "modality": modality, "grasps": size, "rmse": round(rmse, 3)}
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
