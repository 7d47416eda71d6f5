# SPDX-License-Identifier: Apache-2.0
"""Skills of `noise_ceiling` with intervals, by bootstrap over the repeated grasps, as rows, tables and figure.

The intervals are for other grasps of the same objects in the same scene. Ceiling and predictors share the draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.noise_ceiling.repeats import NEW_OBJECT
from foretouch.experiments.shared.figures import draw_intervals, modality_panels
from foretouch.experiments.shared.rows import grouped, listed, select, span, unique
from foretouch.experiments.shared.skill_tables import findings
from foretouch.report.panels import Rows, save
from foretouch.tactile import MODALITIES, P2_RANGES, columns
from foretouch.types import Float64

CEILING: Final = "ceiling"
_TARE: Final = ", change from the tare"
NEVER_TOUCHED: Final = "ceiling, object never touched"
_TAIL: Final = 0.025


def ceiling_rows(rows: Sequence[Row], draws: int) -> list[Row]:
    """Rows of `results.csv`: one per modality for each ceiling, each single cause and each predictor.

    Args:
        rows: Rows of the cells. A predictor whose cell failed is left out.
        draws: Number of bootstrap samples.
    """
    causes = dict(grouped(select(rows, what="repeats"), "name"))
    all_hidden, new_object = causes.pop("all", []), causes.pop(NEW_OBJECT, [])
    result: list[Row] = []
    for name, repeated in ((CEILING, all_hidden), (NEVER_TOUCHED, new_object)):
        if repeated:
            reference = _table(repeated, "reference")
            result += _score(name, _table(repeated, "within"), reference, draws)
            result += _score(name + _TARE, _table(repeated, "within_change"), reference, draws)
    known = {row["id"]: row["reference"] for row in all_hidden}
    for cause, repeated in causes.items():
        if all(row["id"] in known for row in repeated):
            same = np.array([known[row["id"]] for row in repeated])
            result += _score(f"only {cause} hidden", _table(repeated, "within"), same, draws)
    repeated = new_object or all_hidden
    for name, own in grouped(select(rows, what="predictor"), "name") if repeated else ():
        by_id = {row["id"]: row["predicted"] for row in own}
        predicted = np.array([by_id[row["id"]] for row in repeated])
        squared = (predicted - _table(repeated, "mean")) ** 2 + _table(repeated, "rest")  # eq. 2
        result += _score(name, squared, _table(repeated, "reference"), draws, _table(repeated, "within"))
    return result


def _table(rows: Sequence[Row], column: str) -> Float64:
    return np.array([row[column] for row in rows], np.float64)


def _score(name: str, squared: Float64, reference: Float64, draws: int, ceiling: Float64 | None = None) -> list[Row]:
    """One row per modality; with a ceiling also the share of it."""
    size = len(squared)
    weights = np.random.default_rng(0).multinomial(size, np.full(size, 1.0 / size), draws).astype(np.float64)
    weights = np.vstack([np.ones(size), weights])
    skill = _skills(squared, reference, weights)
    share = None if ceiling is None else skill / _skills(ceiling, reference, weights)
    rows = []
    for k, modality in enumerate(MODALITIES):
        rmse = float(np.sqrt(squared[:, columns([modality])].mean()))
        low, high = P2_RANGES.of(modality)
        row = {"name": name, "modality": modality, "grasps": size, "rmse": rmse, "nrmse_p2": rmse / (high - low)}
        rows.append(row | _ends("skill", skill[:, k]) | _ends("share", None if share is None else share[:, k]))
    return rows


def _skills(squared: Float64, reference: Float64, weights: Float64) -> Float64:
    """(draws, 4): 1 - sum S / sum R per value, averaged over the modality's values."""
    per_value = 1.0 - (weights @ squared) / (weights @ reference)
    return np.stack([per_value[:, columns([name])].mean(axis=1) for name in MODALITIES], axis=1)


def _ends(column: str, drawn: Float64 | None) -> Row:
    values = (None,) * 3 if drawn is None else (drawn[0], *np.quantile(drawn[1:], [_TAIL, 1.0 - _TAIL]))
    return dict(zip((column, f"{column}_low", f"{column}_high"), values, strict=True))


def ceiling_tables(rows: Sequence[Row]) -> list[Table]:
    """Skills, the predictors' shares of the ceiling, and errors in percent of P2's ranges."""
    notes = [
        "skill: 0 is the mean of the training labels; [95 % interval by bootstrap over grasps]",
        "only ... hidden: the ceiling if all other causes were known",
    ]
    scored = [row for row in rows if row["share"] is not None]
    ceilings = grouped([row for row in rows if row["name"].startswith(CEILING)], "name")
    sentences = [f"{name}: skills of {listed(own, 'skill')} ({', '.join(MODALITIES)})" for name, own in ceilings]
    for name, own in grouped(scored, "name"):
        sentences.append(f"`{name}` reaches {span(row['share'] for row in own)} of the ceiling")
    errors = [[name, *(f"{100.0 * row['nrmse_p2']:.1f}" for row in own)] for name, own in grouped(rows, "name")]
    tables = [
        findings(sentences),
        Table(f"noise ceiling: {rows[0]['grasps']} grasps", ["skill", *MODALITIES], _body(rows, "skill"), notes),
        Table("share of the ceiling", ["share", *MODALITIES], _body(scored, "share")),
        Table("RMSE in percent of P2's ranges", ["rmse", *MODALITIES], errors),
    ]
    return [table for table in tables if table.rows or table.notes]


def _body(rows: Sequence[Row], column: str) -> list[list[str]]:
    return [
        [name, *(f"{row[column]:.2f} [{row[f'{column}_low']:.2f}, {row[f'{column}_high']:.2f}]" for row in own)]
        for name, own in grouped(rows, "name")
    ]


def draw_ceiling_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `ceiling.png`: modalities side by side, with the predictors' shares of the ceiling."""
    names = unique(rows, "name")
    figure, (panels,) = modality_panels(13.0, (1.2 + 0.35 * len(names),), sharey=True, sharex=True)
    for axes, modality in panels:
        own = select(rows, modality=modality)
        draw_intervals(axes, own, "name", names, lowest=-0.1, colour=lambda row: "C0" if row["share"] is None else "C1")
        for row in own:
            if row["share"] is not None:
                text = f"{100.0 * row['share']:.0f} %"
                axes.annotate(text, (1.0, names.index(row["name"])), ha="right", va="center", fontsize=8)
        axes.set_xlim(-0.1, 1.02)
        axes.set_xlabel("skill (0: training mean)")
    return [save(figure, folder / "ceiling.png")]
