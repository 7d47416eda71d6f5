# SPDX-License-Identifier: Apache-2.0
"""Skill of each predictor as tables, and as figures with a panel for each table and modality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.real_grasps import ALL_OBJECTS
from foretouch.learning.evaluation.metrics import MEAN
from foretouch.report.panels import Rows, mark_off_scale, new_figure, save
from foretouch.tactile import MODALITIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_LEGEND: Final = (
    "skill: 0 is the mean of the training labels, 1 is perfect; [95 % interval by bootstrap over objects]; below it the object "
    "with the lowest skill"
)
_VERDICTS: Final = (
    "▲ significantly better, ▼ significantly worse, = no significant difference (95 % CI) from {references}; "
    "same grasps, paired bootstrap"
)
_SIGNS: Final = {"better": "▲", "worse": "▼", "tie": "="}
_ITSELF: Final = "·"

MODELS: Final = ("contact", "contact_v1")
"""The default model and the one before it; the first in the results is shown in tables by object."""

LOWEST_SKILL: Final = -1.5
"""Lower values are drawn as an arrow with their number at this edge of the figure."""


def skill_tables(rows: Sequence[Row], notes: Sequence[str] = ()) -> list[Table]:
    """A table of skills for each `table` of the results, with a sign for each comparison with a reference."""
    references = [name[3:-8] for name in rows[0] if name.startswith("vs_") and name.endswith("_verdict")]
    legend = [_LEGEND] + [_VERDICTS.format(references=", then from ".join(references))] * bool(references)
    together = [row for row in rows if row["object"] == ALL_OBJECTS]
    tables = []
    for name in dict.fromkeys(row["table"] for row in together):
        of_table = [row for row in together if row["table"] == name]
        predictors = dict.fromkeys(row["predictor"] for row in of_table)
        every = [row for row in rows if row["table"] == name]
        body = [
            [
                one,
                *(_cell(of_table, one, key, references) + _worst(every, one, key) for key in MODALITIES),
                _cell(of_table, one, MEAN, references),
            ]
            for one in predictors
        ]
        title = f"{name}: {of_table[0]['samples']} predictions on {of_table[0]['objects']} objects"
        tables.append(Table(title, ["skill", *MODALITIES, MEAN], body))
    model = next((name for name in MODELS if any(row["predictor"] == name for row in rows)), "")
    tables += object_tables(rows, model)
    return [*tables[:-1], replace(tables[-1], notes=[*legend, *notes])]


def object_tables(rows: Sequence[Row], predictor: str) -> list[Table]:
    """A table of one predictor's skills on each object, for each `table` of the results that has them."""
    tables = []
    for name in dict.fromkeys(row["table"] for row in rows):
        of_table = [row for row in rows if (row["table"], row["predictor"]) == (name, predictor)]
        objects = [one for one in dict.fromkeys(row["object"] for row in of_table) if one != ALL_OBJECTS]
        body = [
            [one, *(_short(row["skill"]) for row in of_table if row["object"] == one and row["skill"] is not None)]
            for one in objects
        ]
        if body:
            tables.append(Table(f"{name}: {predictor}, by object", ["skill", *MODALITIES, MEAN], body))
    return tables


def _worst(rows: Sequence[Row], predictor: str, modality: str) -> str:
    """The object of least skill and that skill; empty for a single object, and where all are the same."""
    found = [
        (row["skill"], row["object"])
        for row in rows
        if (row["predictor"], row["modality"]) == (predictor, modality)
        and row["object"] != ALL_OBJECTS
        and row["skill"] is not None
    ]
    if len({skill for skill, _ in found}) < 2:
        return ""
    skill, name = min(found)
    return f"\n{name} {_short(skill)}"


def _cell(rows: Sequence[Row], predictor: str, modality: str, references: Sequence[str]) -> str:
    row = next(row for row in rows if row["predictor"] == predictor and row["modality"] == modality)
    signs = "".join(_SIGNS.get(row[f"vs_{name}_verdict"] or "", _ITSELF) for name in references)
    text = f"{_short(row['skill'])} {signs.strip(_ITSELF) and signs}".rstrip()
    if row["skill_low"] is not None and modality != MEAN and row["skill_low"] != row["skill_high"]:
        text += f"\n[{_short(row['skill_low'])}, {_short(row['skill_high'])}]"
    return text


def _short(value: float) -> str:
    """Two decimals without the leading zero."""
    return f"{value:.2f}".replace("0.", ".", 1) if abs(value) < 1.0 else f"{value:.1f}"


def draw_skill_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `skill.png`: tables below each other, modalities side by side."""
    # The training mean has a skill of 0 by definition: it is the vertical line.
    shown = [
        row
        for row in rows
        if row["object"] == ALL_OBJECTS and row["skill"] is not None and row["predictor"] != "training_mean"
    ]
    tables = list(dict.fromkeys(row["table"] for row in shown))
    predictors = list(dict.fromkeys(row["predictor"] for row in shown))
    figure = new_figure(12.0, 1.0 + len(tables) * (0.7 + 0.3 * len(predictors)))
    grid = figure.subplots(len(tables), len(MODALITIES), squeeze=False, sharey=True, sharex=True)
    for line, table in zip(grid, tables, strict=True):
        for axes, modality in zip(line, MODALITIES, strict=True):
            draw_skills(axes, [r for r in shown if r["table"] == table and r["modality"] == modality], predictors)
            axes.set_title(f"{table}: {modality}", fontsize=10)
    grid[0, 0].set_ylim(len(predictors) - 0.5, -0.5)
    for axes in grid[-1]:
        axes.set_xlabel("skill (0: training mean)")
    return [save(figure, folder / "skill.png")]


def draw_skills(axes: Axes, rows: Rows, predictors: Sequence[str]) -> None:
    """Draw skill and interval of each predictor, one above the other."""
    for row in rows:
        y = predictors.index(row["predictor"])
        colour = f"C{y % 10}"
        if row["skill"] < LOWEST_SKILL:
            mark_off_scale(axes, LOWEST_SKILL, y, f"{row['skill']:.1f}", colour)
            continue
        axes.plot(row["skill"], y, marker="o", color=colour)
        if row["skill_low"] is not None:
            axes.plot([max(row["skill_low"], LOWEST_SKILL), row["skill_high"]], [y, y], color=colour)
    axes.axvline(0.0, color="grey", linewidth=0.8)
    axes.set_yticks(range(len(predictors)), predictors)
    axes.grid(visible=True, axis="x", alpha=0.3)
