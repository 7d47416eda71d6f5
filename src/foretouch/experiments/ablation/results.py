# SPDX-License-Identifier: Apache-2.0
"""Skills of `ablation` with differences from the full model or from no adaptation, as rows, tables and figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from foretouch.experiments.ablation.variants import FULL
from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.figures import VERDICT_COLOURS, draw_intervals, modality_panels
from foretouch.experiments.shared.rows import SIGNS, grouped, select, short, unique
from foretouch.experiments.shared.scores import ALL_OBJECTS, score_table
from foretouch.experiments.shared.skill_tables import COLUMNS, findings
from foretouch.learning.evaluation.metrics import MEAN, BootstrapConfig
from foretouch.report.panels import Rows, save

NOTHING: Final = "nothing"
TARE: Final = "tare"

_LOWEST_DIFFERENCE: Final = -0.3
"""Lower values are drawn as an arrow with their number at this edge of the figure."""


def ablation_rows(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, without those of single objects.

    Args:
        rows: Rows of `error_rows`, with `table`, `part`, `predictor` (the variant) and `seed`. Errors on an object that
            several splits tested are added up.
        config: Configuration of the bootstrap.
    """
    result = []
    for _, own in grouped(rows, "table"):
        variants = unique(own, "predictor")
        reference = FULL if FULL in variants else NOTHING
        for row in select(score_table(own, variants, [reference], config), object=ALL_OBJECTS):
            versus = {
                f"difference{name.removeprefix(f'vs_{reference}')}": row.pop(name)
                for name in list(row)
                if name.startswith("vs_")
            }
            result.append({**row, "reference": reference, **versus})
    return result


def ablation_tables(rows: Sequence[Row]) -> list[Table]:
    """A table for each condition: skill, and its difference from the full model or from no adaptation."""
    tables, sentences = [], []
    for name, own in grouped(rows, "table"):
        body = [[variant, *map(_cell, cells)] for variant, cells in grouped(own, "predictor")]
        title = f"{name}: {own[0]['objects']} objects, compared with `{own[0]['reference']}`"
        tables.append(Table(title, COLUMNS, body))
        means = {row["predictor"]: row for row in select(own, modality=MEAN)}
        texts = [
            f"{variant} {short(row['skill'])}{SIGNS.get(row['difference_verdict'], '')}"
            for variant, row in means.items()
        ]
        sentences.append(f"{name}: mean skill of {', '.join(texts)}")
    notes = [
        "skill: 0 is the mean of the training labels, 1 is perfect",
        "(difference from the reference [95 % interval by bootstrap over objects])",
        "▲ significantly better, ▼ significantly worse, = no significant difference",
    ]
    return [findings(sentences), *tables[:-1], replace(tables[-1], notes=notes)]


def _cell(row: Row) -> str:
    text = f"{row['skill']:.3f}"
    if row["difference"] is None:
        return text
    text += f" ({row['difference']:+.3f} {SIGNS.get(row['difference_verdict'], '')}".rstrip()
    if row["difference_low"] is not None:
        text += f"\n[{row['difference_low']:+.3f}, {row['difference_high']:+.3f}]"
    return f"{text})"


def draw_ablation_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `ablation.png`: differences from the reference, tables below each other, modalities side by side."""
    shown = grouped([row for row in rows if row["predictor"] != row["reference"]], "table")
    heights = [0.9 + 0.22 * len(unique(own, "predictor")) for _, own in shown]
    figure, lines = modality_panels(15.0, heights, [name for name, _ in shown], sharex="row", sharey="row")
    for line, (_, own) in zip(lines, shown, strict=True):
        variants = unique(own, "predictor")
        for axes, modality in line:
            draw_intervals(
                axes,
                select(own, modality=modality),
                "predictor",
                variants,
                values="difference",
                lowest=_LOWEST_DIFFERENCE,
                colour=lambda row: VERDICT_COLOURS.get(row["difference_verdict"], "grey"),
            )
        line[0][0].set_xlabel(f"skill difference from `{own[0]['reference']}`", fontsize=8)
    figure.suptitle(
        "green: significantly better, red: significantly worse, grey: no significant difference "
        "(95 % interval by bootstrap over objects)",
        fontsize=9,
    )
    return [save(figure, folder / "ablation.png")]
