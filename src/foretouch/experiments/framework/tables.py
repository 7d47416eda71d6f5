# SPDX-License-Identifier: Apache-2.0
"""Rows of `results.csv` as the tables that a person reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.real_grasps import EVERYTHING
from foretouch.learning.evaluation.comparison import MEAN
from foretouch.tactile.modalities import MODALITIES

__all__ = ["LEGEND", "markdown", "skill_tables"]

LEGEND: Final = (
    "skill: 0 is the mean of the training labels, 1 is perfect; [95 % interval by bootstrap over objects]",
    "▲ better, ▼ worse, = tie with {references} on the same grasps, in paired draws",
)
_SIGNS: Final = {"better": "▲", "worse": "▼", "tie": "="}
_ITSELF: Final = "·"


def skill_tables(rows: Sequence[Row], notes: Sequence[str] = ()) -> list[Table]:
    """One table of skills for each `table` of the results, with a sign for each of those that it is compared with."""
    references = [name[3:-8] for name in rows[0] if name.startswith("vs_") and name.endswith("_verdict")]
    named = ", then with ".join(references)
    legend = [line.format(references=named) for line in LEGEND if references or "{" not in line]
    together = [row for row in rows if row["object"] == EVERYTHING]
    tables = []
    for name in dict.fromkeys(row["table"] for row in together):
        mine = [row for row in together if row["table"] == name]
        who = dict.fromkeys(row["predictor"] for row in mine)
        body = [[one, *(_cell(mine, one, key, references) for key in (*MODALITIES, MEAN))] for one in who]
        first = mine[0]
        title = f"{name}: {first['samples']} predictions on {first['objects']} objects"
        tables.append(Table(title, ["skill", *MODALITIES, MEAN], body))
    last = tables[-1]
    return [*tables[:-1], Table(last.title, last.columns, last.rows, [*legend, *notes])]


def markdown(title: str, tables: Sequence[Table]) -> str:
    """Tables and their notes as a page."""
    lines = [f"# {title}", ""]
    for table in tables:
        lines += [f"## {table.title}", ""]
        if table.rows:
            header = [list(table.columns), ["---", *["---:"] * (len(table.columns) - 1)]]
            lines += [f"| {' | '.join(row)} |".replace("\n", "<br>") for row in [*header, *table.rows]]
            lines.append("")
        lines += [f"- {note}" for note in table.notes]
        lines += [""] * bool(table.notes)
    return "\n".join(lines[:-1]) + "\n"


def _cell(rows: Sequence[Row], predictor: str, modality: str, references: Sequence[str]) -> str:
    row = next(row for row in rows if row["predictor"] == predictor and row["modality"] == modality)
    signs = "".join(_SIGNS.get(row[f"vs_{name}_verdict"] or "", _ITSELF) for name in references)
    text = f"{_short(row['skill'])} {signs.strip(_ITSELF) and signs}".rstrip()
    if row["skill_low"] is not None and modality != MEAN and row["skill_low"] != row["skill_high"]:
        text += f"\n[{_short(row['skill_low'])}, {_short(row['skill_high'])}]"
    return text


def _short(value: float) -> str:
    """Two decimals without the zero before them."""
    return f"{value:.2f}".replace("0.", ".", 1) if abs(value) < 1.0 else f"{value:.1f}"
