# SPDX-License-Identifier: Apache-2.0
"""Skills of `ablation` with differences from the full model or from no adaptation, as rows, tables and figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from foretouch.experiments.ablation.variants import FULL
from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.scores import ALL_OBJECTS, score_table
from foretouch.learning.evaluation.metrics import MEAN, BootstrapConfig
from foretouch.report.panels import Rows, mark_off_scale, new_figure, save
from foretouch.tactile import MODALITIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes


NOTHING: Final = "nothing"
TARE: Final = "tare"
_TOUCHES: Final = "3 touches"

TARES_AND_TOUCHES: Final = ": what is leaned on"
"""End of the name of the table on tares and touches, in `results.csv`."""

_LOWEST_DIFFERENCE: Final = -0.3
"""Lower values are drawn as an arrow with their number at this edge of the figure."""

_SIGNS: Final = {"better": " ▲", "worse": " ▼", "tie": " ="}


def ablation_rows(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, without those of single objects.

    Args:
        rows: Rows of `error_rows`, with `table`, `part`, `predictor` (the variant) and `seed`. Errors on an object that
            several splits tested are added up.
        config: Configuration of the bootstrap.
    """
    variants = tuple(dict.fromkeys(row["predictor"] for row in rows))
    scored = score_table(rows, variants, (FULL, NOTHING, TARE, _TOUCHES), config)
    return [row for row in scored if row["object"] == ALL_OBJECTS]


def ablation_tables(rows: Sequence[Row]) -> list[Table]:
    """A table for each ground: skill, and its difference from the full model or from no adaptation."""
    tables = []
    for name in dict.fromkeys(row["table"] for row in rows):
        subset = [row for row in rows if row["table"] == name]
        variants = list(dict.fromkeys(row["predictor"] for row in subset))
        reference = _reference(variants)
        body = [[one, *(_cell(row, reference) for row in subset if row["predictor"] == one)] for one in variants]
        title = f"{_title(name)}: {subset[0]['objects']} objects, compared with `{reference}`"
        tables.append(Table(title, ["skill", *MODALITIES, MEAN], body))
    notes = [
        "skill: 0 is the mean of the training labels, 1 is perfect",
        "(difference from the reference [95 % interval by bootstrap over objects])",
        "▲ significantly better, ▼ significantly worse, = no significant difference",
    ]
    return [*tables[:-1], replace(tables[-1], notes=notes)]


def _reference(variants: Sequence[str]) -> str:
    return FULL if FULL in variants else NOTHING


def _title(table: str) -> str:
    return table.replace(TARES_AND_TOUCHES, ", with tare and touches")


def _cell(row: Row, reference: str) -> str:
    text = f"{row['skill']:.3f}"
    if row[f"vs_{reference}"] is None:
        return text
    difference = f"({row[f'vs_{reference}']:+.3f}{_SIGNS.get(row[f'vs_{reference}_verdict'], '')}"
    if row[f"vs_{reference}_low"] is not None:
        difference += f"\n[{row[f'vs_{reference}_low']:+.3f}, {row[f'vs_{reference}_high']:+.3f}]"
    return f"{text} {difference})"


def draw_ablation_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `ablation.png`: tables below each other, modalities side by side."""
    tables = list(dict.fromkeys(row["table"] for row in rows))
    sizes = [len({row["predictor"] for row in rows if row["table"] == table}) - 1 for table in tables]
    figure = new_figure(15.0, 0.6 + sum(0.9 + 0.22 * size for size in sizes))
    ratios = [3.0 + size for size in sizes]
    grid = figure.subplots(
        len(tables), len(MODALITIES), squeeze=False, height_ratios=ratios, sharex="row", sharey="row"
    )
    for line, table in zip(grid, tables, strict=True):
        subset = [row for row in rows if row["table"] == table]
        reference = _reference([row["predictor"] for row in subset])
        variants = list(dict.fromkeys(row["predictor"] for row in subset if row["predictor"] != reference))
        for axes, modality in zip(line, MODALITIES, strict=True):
            shown = [row for row in subset if row["modality"] == modality and row["predictor"] != reference]
            draw_differences(axes, shown, variants, f"vs_{reference}")
            axes.set_title(f"{_title(table)}: {modality}", fontsize=8)
        line[0].set_xlabel(f"skill difference from `{reference}`", fontsize=8)
        line[0].set_ylim(len(variants) - 0.5, -0.5)
    figure.suptitle(
        "green: significantly better, red: significantly worse, grey: no significant difference "
        "(95 % interval by bootstrap over objects)",
        fontsize=9,
    )
    return [save(figure, folder / "ablation.png")]


def draw_differences(axes: Axes, rows: Rows, variants: Sequence[str], column: str) -> None:
    """Draw difference and interval of each variant, one below the other, coloured by significance."""
    colours = {"better": "C2", "worse": "C3"}
    for row in rows:
        y, value = variants.index(row["predictor"]), row[column]
        colour = colours.get(row[f"{column}_verdict"], "grey")
        if value < _LOWEST_DIFFERENCE:
            mark_off_scale(axes, _LOWEST_DIFFERENCE, y, f"{value:.2f}", colour)
            continue
        axes.plot(value, y, marker="o", color=colour, markersize=4)
        if row[f"{column}_low"] is not None:
            axes.plot([max(row[f"{column}_low"], _LOWEST_DIFFERENCE), row[f"{column}_high"]], [y, y], color=colour)
    axes.axvline(0.0, color="black", linewidth=0.6)
    axes.set_yticks(range(len(variants)), variants, fontsize=8)
    axes.tick_params(axis="x", labelsize=7)
    axes.grid(visible=True, axis="x", alpha=0.3)
