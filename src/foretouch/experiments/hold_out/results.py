# SPDX-License-Identifier: Apache-2.0
"""Tables and figures of the hold-out experiments, beyond those of skills."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.hold_out.splits import KNOWN, OBJECT_KNOWN, UNITS, CrossTypeSettings, LookalikesSettings
from foretouch.experiments.shared.figures import draw_series, draw_skill_figure, legend_of, modality_panels
from foretouch.experiments.shared.p1 import ACROSS, P1, PUBLISHED, draw_errors
from foretouch.experiments.shared.predictors import SHRINKAGE
from foretouch.experiments.shared.rows import grouped, select, short, span, unique
from foretouch.experiments.shared.scores import ALL_OBJECTS, score_table
from foretouch.experiments.shared.skill_tables import MODEL, findings, skill_tables
from foretouch.learning.evaluation.metrics import MEAN
from foretouch.report.panels import Rows, save
from foretouch.tactile import MODALITIES, P1_RANGES

_SPREAD: Final = 0.12
_CORRECTION: Final = f"after n touches, predictors without adaptation add n / (n + {SHRINKAGE:g}) of their mean residual, as does the mean"


def touch_table(count: int) -> str:
    """Name of the table after a number of touches."""
    return "no touch" if count == 0 else f"after {count} touch" + ("es" if count > 1 else "")


def summarise_touches(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each number of touches."""
    return skill_tables(rows, [_CORRECTION])


def draw_touches(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: all objects together above, each object below, with the default model if it was run."""
    predictors = unique(rows, "predictor")
    chosen = MODEL if MODEL in predictors else predictors[-1]
    names = sorted(set(unique(rows, "object")) - {ALL_OBJECTS})
    figure, (above, below) = modality_panels(14.0, (3.75, 3.75), sharex=True, sharey="row")
    for axes, modality in above:
        own = select(rows, modality=modality, object=ALL_OBJECTS)
        draw_series(axes, own, "touches", "predictor", predictors, spread=_SPREAD, lowest=-1.0)
    for axes, modality in below:
        own = select(rows, modality=modality, predictor=chosen)
        draw_series(axes, own, "touches", "object", names, lowest=-1.0)
        axes.set_xlabel("touches of the new object")
    above[0][0].set_ylabel("skill, all objects, 95 % interval")
    below[0][0].set_ylabel(f"skill, {chosen}, each object")
    legend_of(figure, above[0][0], "right upper")
    legend_of(figure, below[0][0], "right lower")
    return [save(figure, folder / "touches.png")]


def tabulate_lookalikes(settings: LookalikesSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of all look-alikes together and of each, by the column `kind`; sessions have no rows of their own."""
    rows = [{"touches": None, **row, "kind": row["object"].rpartition("/")[0]} for row in rows]
    result: list[Row] = []
    for kind in (ALL_OBJECTS, *sorted(set(unique(rows, "kind")))):
        own = rows if kind == ALL_OBJECTS else select(rows, kind=kind)
        scored = score_table(own, settings.predictors, settings.references, settings.bootstrap, ("touches",))
        result += [{"kind": kind, **row} for row in select(scored, object=ALL_OBJECTS)]
    return result


def summarise_lookalikes(rows: Sequence[Row]) -> list[Table]:
    """Tables of all look-alikes together."""
    gain = "the cloud does not show which object it is: without a touch, the best prediction is the mean of all"
    return skill_tables(select(rows, kind=ALL_OBJECTS), [_CORRECTION, gain])


def draw_lookalikes(rows: Rows, folder: Path) -> list[Path]:
    """Draw `lookalikes.png`: all sessions together; dashed if trained on the object alone."""
    together = select(rows, kind=ALL_OBJECTS)
    predictors = unique(together, "predictor")
    figure, (panels,) = modality_panels(13.0, (3.8,), sharey=True, sharex=True)
    for axes, modality in panels:
        own = select(together, modality=modality)
        touched = [row for row in own if row["touches"] is not None]
        draw_series(axes, touched, "touches", "predictor", predictors, spread=_SPREAD, lowest=-0.2)
        for row in select(own, table=OBJECT_KNOWN):
            axes.axhline(row["skill"], color=f"C{predictors.index(row['predictor'])}", linestyle="--", linewidth=0.8)
        axes.set_xlabel("touches of the object")
    panels[0][0].set_ylabel("skill, 95 % interval\n(dashed: trained on that object alone)")
    legend_of(figure, panels[0][0], "right center")
    return [save(figure, folder / "lookalikes.png")]


def tabulate_types(settings: CrossTypeSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of each table, of both directions together, and P1's published errors.

    P1 does not state in which direction it crossed the types.
    """
    crossed = [{**row, "table": ACROSS} for row in rows if " to " in row["table"]]
    table = score_table([*rows, *crossed], settings.predictors, settings.references, settings.bootstrap, ("untyped",))
    for name, figures in PUBLISHED.items():
        beside = select(table, table=name, object=ALL_OBJECTS)[:1]
        for modality, (rmse, _) in figures.items() if beside else ():
            known = {"table": name, "predictor": P1, "object": ALL_OBJECTS, "modality": modality, "rmse": rmse}
            table.append({**dict.fromkeys(beside[0]), "untyped": beside[0]["untyped"], **known})
    return table


def summarise_types(rows: Sequence[Row]) -> list[Table]:
    """Tables of errors beside P1's, then of skills."""
    ours = [row for row in rows if row["predictor"] != P1]
    notes = [
        "P1's boxes were a snacks box (cheezit) and a sugar box, which is not in the public data",
        f"objects of no type, left out: {rows[0]['untyped'] or 'none'}",
        "fewer than 6 objects: no interval, since none would reach a coverage of 95 %",
    ]
    tables, ratios = [], []
    for name, figures in PUBLISHED.items():
        together = select(rows, table=name, object=ALL_OBJECTS)
        body = [
            [one, *(_error_text(row) for row in own if row["modality"] != MEAN)]
            for one, own in grouped(together, "predictor")
        ]
        tables.append(Table(f"{name}: RMSE in counts (over P1's divisors)", ["rmse", *MODALITIES], body))
        means = select(together, predictor="training_mean")[: len(MODALITIES)]
        ratios += [figures[row["modality"]][0] / row["rmse"] for row in means]
    sentence = f"P1's published errors are {span(ratios, 1)} times those of the mean of the training labels"
    first, *skills = skill_tables(ours, notes, [sentence] if ratios else [])
    return [first, *tables, *skills]


def _error_text(row: Row) -> str:
    if row["predictor"] == P1:
        scaled = PUBLISHED[row["table"]][row["modality"]][1]
    else:
        low, high = P1_RANGES.of(row["modality"])
        scaled = row["rmse"] / (high - low)
    return f"{row['rmse']:.0f}" + ("" if scaled is None else f" ({scaled:.3f})")


def draw_types(rows: Rows, folder: Path) -> list[Path]:
    """Draw `rmse.png`, the tables that P1 has too, and `skill.png`, all tables."""
    together = select(rows, object=ALL_OBJECTS)
    tables, predictors = unique(select(together, predictor=P1), "table"), unique(together, "predictor")
    figure, (panels,) = modality_panels(12.0, (3.4,))
    for axes, modality in panels:
        own = [row for row in select(together, modality=modality) if row["table"] in tables]
        draw_errors(axes, own, tables, predictors, "rmse")
    panels[0][0].set_ylabel("RMSE [counts]")
    legend_of(figure, panels[0][0], "right center")
    return [save(figure, folder / "rmse.png"), *draw_skill_figure(rows, folder)]


def summarise_sizes(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each condition and size, and a sentence on the mean skill of each condition."""
    sentences = []
    for (condition, predictor), own in grouped(
        select(rows, object=ALL_OBJECTS, modality=MEAN), "condition", "predictor"
    ):
        counts, values = (", ".join(map(str, unique(own, "size"))), ", ".join(short(row["skill"]) for row in own))
        sentences.append(f"{condition}: with {counts} {UNITS[condition]} `{predictor}` has mean skills of {values}")
    note = "the mean of the training labels is that of the full training set at every size"
    return [findings(sentences), *skill_tables(rows, [note])[1:]]


def draw_sizes(rows: Rows, folder: Path) -> list[Path]:
    """Draw `curve.png`: conditions below each other, modalities side by side."""
    conditions, predictors = grouped(select(rows, object=ALL_OBJECTS), "condition"), unique(rows, "predictor")
    heights = [3.0] * len(conditions)
    figure, lines = modality_panels(14.0, heights, [name for name, _ in conditions], sharey="row")
    for line, (condition, own) in zip(lines, conditions, strict=True):
        for axes, modality in line:
            draw_series(axes, select(own, modality=modality), "size", "predictor", predictors, spread=_SPREAD)
            axes.set_ylim(max(-0.6, axes.get_ylim()[0]), None)
            axes.set_xlabel("training grasps per object" if condition == KNOWN else "training objects")
        line[0][0].set_ylabel("skill, 95 % interval")
    lines[0][-1][0].legend(fontsize=8)
    return [save(figure, folder / "curve.png")]
