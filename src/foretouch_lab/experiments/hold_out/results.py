# SPDX-License-Identifier: Apache-2.0
"""Tables and figures of the hold-out experiments, beyond those of skills."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

from foretouch.report.panels import Rows
from foretouch.tactile import MODALITIES, P1_RANGES
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.hold_out.splits import CrossTypeSettings, LookalikesSettings
from foretouch_lab.experiments.p1_as_published import ACROSS, P1, PUBLISHED
from foretouch_lab.experiments.shared.figures import Line, draw_series, save_panels
from foretouch_lab.experiments.shared.predictors import SHRINKAGE
from foretouch_lab.experiments.shared.scores import score_table
from foretouch_lab.experiments.shared.tables import ALL_OBJECTS, MODEL, pivot, select, skill_tables, unique
from foretouch_lab.learning.evaluation.metrics import MEAN

_CORRECTION: Final = f"after n touches, predictors without adaptation add n / (n + {SHRINKAGE:g}) of their mean residual, as does the mean"


def summarise_touches(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each number of touches."""
    return skill_tables(rows, [_CORRECTION])


def draw_touches(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: all objects together above, each object below, with the default model if it was run."""
    predictors = unique(rows, "predictor")
    chosen = MODEL if MODEL in predictors else predictors[-1]
    objects = sorted(set(unique(rows, "object")) - {ALL_OBJECTS})
    together = partial(draw_series, x="touches", series="predictor", names=predictors, lowest=-1.0, spread=0.12)
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
    tables = []
    for name in PUBLISHED:
        together = [row for row in select(rows, table=name, object=ALL_OBJECTS) if row["modality"] != MEAN]
        title = f"{name}: RMSE in counts (over P1's divisors)"
        tables.append(Table(title, ["rmse", *MODALITIES], pivot(together, "predictor", _error_text)))
    return [*tables, *skill_tables([row for row in rows if row["predictor"] != P1], notes)]


def _error_text(row: Row) -> str:
    low, high = P1_RANGES.ranges.of(row["modality"])
    ours = row["rmse"] / (high - low)
    scaled = PUBLISHED[row["table"]][row["modality"]][1] if row["predictor"] == P1 else ours
    return f"{row['rmse']:.0f}" + ("" if scaled is None else f" ({scaled:.3f})")


def summarise_sizes(rows: Sequence[Row]) -> list[Table]:
    """A table of skills for each condition and size."""
    note = "the mean of the training labels is that of the full training set at every size"
    return skill_tables(rows, [note])
