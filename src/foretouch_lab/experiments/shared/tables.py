# SPDX-License-Identifier: Apache-2.0
"""Select and group rows, and write tables of them: texts of numbers, tables of skills, and sentences."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar

from foretouch.tactile import MODALITIES
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.learning.evaluation.metrics import MEAN

ALL_OBJECTS: Final = "all"  # value of the column `object` for all objects together

R = TypeVar("R", bound=Mapping[str, Any])

MODEL: Final = "contact"  # the default model, which is shown by object if it was run

SIGNS: Final = {"better": "▲", "worse": "▼", "tie": "="}  # by verdict of a comparison

SKILL_COLUMNS: Final = ("skill", *MODALITIES, MEAN)

_LEGEND: Final = (
    "skill: 0 is the mean of the training labels, 1 is perfect; [95 % interval by bootstrap over objects]; below it the object "
    "with the lowest skill"
)
_VERDICTS: Final = (
    "▲ significantly better, ▼ significantly worse, = no significant difference (95 % CI) from {references}; "
    "same grasps, paired bootstrap"
)
_ITSELF: Final = "·"


def select(rows: Iterable[R], **wanted: Any) -> list[R]:
    """Return rows that have the given values."""
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def unique(rows: Iterable[Mapping[str, Any]], column: str) -> list[Any]:
    """Return values of a column, each once, in order of their first rows."""
    return list(dict.fromkeys(row[column] for row in rows))


def grouped(rows: Iterable[R], *columns: str) -> list[tuple[Any, list[R]]]:
    """Return each value of a column, or tuple of values of several, with its rows; in order of their first rows."""
    groups: dict[Any, list[R]] = {}
    for row in rows:
        key = row[columns[0]] if len(columns) == 1 else tuple(row[name] for name in columns)
        groups.setdefault(key, []).append(row)
    return list(groups.items())


def pivot(
    rows: Iterable[R],
    line: str,
    text: Callable[..., str],
    names: Sequence[Any] = MODALITIES,
    label: Callable[[Any], str] = str,
) -> list[list[str]]:
    """Return a line of a table for each value of a column, and in it a cell for each of the `names` of the modalities.

    Args:
        rows: Of one table.
        line: Column whose values name the lines.
        text: From the rows of a cell, usually one, as arguments to its text; a cell without a row is empty.
        names: Of the modalities, in order.
        label: From a value of the column to the name of its line.
    """
    body = []
    for name, own in grouped(rows, line):
        cells = {key: text(*selected) for key, selected in grouped(own, "modality")}
        body.append([label(name), *(cells.get(key, "") for key in names)])
    return body


def short(value: float | None) -> str:
    """Return a number without the zero before its point, and with one decimal less from 1 on; `–` for None."""
    if value is None:
        return "–"
    return f"{value:.2f}".replace("0.", ".", 1) if abs(value) < 1.0 else f"{value:.1f}"


def with_notes(tables: Sequence[Table], notes: Sequence[str]) -> list[Table]:
    """Return tables with notes below the last one."""
    return [*tables[:-1], replace(tables[-1], notes=notes)]


def skill_tables(rows: Sequence[Row], notes: Sequence[str] = ()) -> list[Table]:
    """Return a table of skills for each `table` of the results, with a sign for each comparison."""
    references = [name[3:-8] for name in rows[0] if name.startswith("vs_") and name.endswith("_verdict")]
    tables, by_object = [], []
    names = SKILL_COLUMNS[1:]
    for table, own in grouped(rows, "table"):
        together = select(own, object=ALL_OBJECTS)
        body = pivot(together, "predictor", lambda row, own=own: _cell(row, references, own), names=names)
        title = f"{table}: {together[0]['samples']} predictions on {together[0]['objects']} objects"
        tables.append(Table(title, SKILL_COLUMNS, body))
        single = [row for row in select(own, predictor=MODEL) if row["object"] != ALL_OBJECTS]
        if single:
            body = pivot(single, "object", lambda row: short(row["skill"]), names=names)
            by_object.append(Table(f"{table}: {MODEL}, by object", SKILL_COLUMNS, body))
    legend = [_LEGEND]
    if references:
        legend.append(_VERDICTS.format(references=", then from ".join(references)))
    return with_notes([*tables, *by_object], [*legend, *notes])


def _cell(row: Row, references: Sequence[str], of_table: Sequence[Row]) -> str:
    """Return skill, signs of its comparisons and interval; the object with the lowest skill where there are several."""
    signs = "".join(SIGNS.get(row[f"vs_{name}_verdict"] or "", _ITSELF) for name in references)
    if not signs.strip(_ITSELF):
        signs = ""
    text = f"{short(row['skill'])} {signs}".rstrip()
    if row["modality"] == MEAN:
        return text
    if row["skill_low"] is not None and row["skill_low"] != row["skill_high"]:
        text += f"\n[{short(row['skill_low'])}, {short(row['skill_high'])}]"
    own = select(of_table, predictor=row["predictor"], modality=row["modality"])
    single = [(row["skill"], row["object"]) for row in own if row["object"] != ALL_OBJECTS]
    if len({skill for skill, _ in single}) > 1:
        skill, name = min(single)
        text += f"\n{name} {short(skill)}"
    return text
