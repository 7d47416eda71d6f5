# SPDX-License-Identifier: Apache-2.0
"""Tables and figures of the hold-out experiments, beyond those of skills."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

from foretouch.report.panels import Axes, Rows
from foretouch.tactile import MODALITIES, P1_RANGES
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.hold_out.splits import KNOWN, OBJECT_KNOWN, UNITS, CrossTypeSettings, LookalikesSettings
from foretouch_lab.experiments.p1_as_published import ACROSS, P1, PUBLISHED, draw_errors
from foretouch_lab.experiments.shared.figures import Line, draw_series, save_panels
from foretouch_lab.experiments.shared.predictors import SHRINKAGE
from foretouch_lab.experiments.shared.scores import score_table
from foretouch_lab.experiments.shared.tables import (
    ALL_OBJECTS,
    MODEL,
    findings,
    grouped,
    pivot,
    select,
    short,
    skill_tables,
    span,
    unique,
)
from foretouch_lab.learning.evaluation.metrics import MEAN

_CORRECTION: Final = f"after n touches, predictors without adaptation add n / (n + {SHRINKAGE:g}) of their mean residual, as does the mean"
_by_predictor = partial(draw_series, series="predictor", spread=0.12)


def summarise_touches(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each number of touches."""
    return skill_tables(rows, [_CORRECTION])


def draw_touches(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: all objects together above, each object below, with the default model if it was run."""
    predictors = unique(rows, "predictor")
    chosen = MODEL if MODEL in predictors else predictors[-1]
    objects = sorted(set(unique(rows, "object")) - {ALL_OBJECTS})
    together = partial(_by_predictor, x="touches", names=predictors, lowest=-1.0)
    each = partial(draw_series, x="touches", series="object", names=objects, lowest=-1.0)
    own = [row for row in select(rows, predictor=chosen) if row["object"] != ALL_OBJECTS]
    every, label = select(rows, object=ALL_OBJECTS), "skill, all objects, 95 % interval"
    lines = [
        Line(3.75, every, together, y_label=label, legend="right upper"),
        Line(3.75, own, each, "", "touches of the new object", f"skill, {chosen}, each object", "right lower"),
    ]
    return save_panels(folder / "touches.png", 14.0, lines, sharex=True, sharey="row")


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
    unseen = "the cloud does not show which object it is: without a touch, the best prediction is the mean of all"
    return skill_tables(select(rows, kind=ALL_OBJECTS), [_CORRECTION, unseen])


def draw_lookalikes(rows: Rows, folder: Path) -> list[Path]:
    """Draw `lookalikes.png`: all sessions together; dashed if trained on the object alone."""
    together = select(rows, kind=ALL_OBJECTS)
    predictors = unique(together, "predictor")

    def _draw(axes: Axes, own: Rows) -> None:
        touched = [row for row in own if row["touches"] is not None]
        _by_predictor(axes, touched, x="touches", names=predictors, lowest=-0.2)
        for row in select(own, table=OBJECT_KNOWN):
            axes.axhline(row["skill"], color=f"C{predictors.index(row['predictor'])}", linestyle="--", linewidth=0.8)

    label = "skill, 95 % interval\n(dashed: trained on that object alone)"
    line = Line(3.8, together, _draw, "", "touches of the object", label, "right center")
    return save_panels(folder / "lookalikes.png", 13.0, [line], sharey=True, sharex=True)


def tabulate_types(settings: CrossTypeSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of each table, of both directions together, and P1's published errors.

    P1 does not state in which direction it crossed the types.
    """
    both = [*rows, *({**row, "table": ACROSS} for row in rows if " to " in row["table"])]
    table = score_table(both, settings.predictors, settings.references, settings.bootstrap, ("untyped",))
    for name, figures in PUBLISHED.items():
        for beside in select(table, table=name, object=ALL_OBJECTS)[:1]:
            empty = {**dict.fromkeys(beside), "untyped": beside["untyped"], "table": name, "object": ALL_OBJECTS}
            found = [{"modality": modality, "rmse": rmse} for modality, (rmse, _) in figures.items()]
            table += [{**empty, "predictor": P1, **one} for one in found]
    return table


def summarise_types(rows: Sequence[Row]) -> list[Table]:
    """Tables of errors beside P1's, then of skills."""
    notes = [
        "P1's boxes were a snacks box (cheezit) and a sugar box, which is not in the public data",
        f"objects of no type, left out: {rows[0]['untyped'] or 'none'}",
        "fewer than 6 objects: no interval, since none would reach a coverage of 95 %",
    ]
    tables, ratios = [], []
    for name, figures in PUBLISHED.items():
        together = [row for row in select(rows, table=name, object=ALL_OBJECTS) if row["modality"] != MEAN]
        title = f"{name}: RMSE in counts (over P1's divisors)"
        tables.append(Table(title, ["rmse", *MODALITIES], pivot(together, "predictor", _error_text)))
        ratios += [figures[row["modality"]][0] / row["rmse"] for row in select(together, predictor="training_mean")]
    sentences = [f"P1's published errors are {span(ratios)} times those of the mean of the training labels"]
    first, *others = skill_tables([row for row in rows if row["predictor"] != P1], notes, sentences if ratios else [])
    return [first, *tables, *others]


def _error_text(row: Row) -> str:
    low, high = P1_RANGES.ranges.of(row["modality"])
    ours = row["rmse"] / (high - low)
    scaled = PUBLISHED[row["table"]][row["modality"]][1] if row["predictor"] == P1 else ours
    return f"{row['rmse']:.0f}" + ("" if scaled is None else f" ({scaled:.3f})")


def draw_types(rows: Rows, folder: Path) -> list[Path]:
    """Draw `rmse.png`: the tables that P1 has too."""
    together = select(rows, object=ALL_OBJECTS)
    tables = unique(select(together, predictor=P1), "table")
    draw = partial(draw_errors, tables=tables, predictors=unique(together, "predictor"), values="rmse")
    own = [row for row in together if row["table"] in tables]
    line = Line(3.4, own, draw, y_label="RMSE [counts]", legend="right center")
    return save_panels(folder / "rmse.png", 12.0, [line])


def summarise_sizes(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each condition and size, and a sentence on the mean skill of each condition."""
    sentences = []
    for place, own in grouped(select(rows, object=ALL_OBJECTS, modality=MEAN), "condition", "predictor"):
        sizes, values = ", ".join(str(row["size"]) for row in own), ", ".join(short(row["skill"]) for row in own)
        sentences.append(f"{place[0]}: with {sizes} {UNITS[place[0]]} `{place[1]}` has mean skills of {values}")
    note = "the mean of the training labels is that of the full training set at every size"
    return [findings(sentences), *skill_tables(rows, [note])[1:]]


def draw_sizes(rows: Rows, folder: Path) -> list[Path]:
    """Draw `curve.png`: conditions below each other, modalities side by side."""
    predictors, label = unique(rows, "predictor"), "skill, 95 % interval"

    def _draw(axes: Axes, own: Rows) -> None:
        _by_predictor(axes, own, x="size", names=predictors)
        axes.set_ylim(max(-0.6, axes.get_ylim()[0]), None)

    lines = [
        Line(3.0, own, _draw, name, f"training {'grasps per object' if name == KNOWN else 'objects'}", label)
        for name, own in grouped(select(rows, object=ALL_OBJECTS), "condition")
    ]
    lines[0] = lines[0]._replace(legend="right upper")
    return save_panels(folder / "curve.png", 14.0, lines, sharey="row")
