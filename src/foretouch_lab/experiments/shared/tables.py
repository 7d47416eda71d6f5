# SPDX-License-Identifier: Apache-2.0
"""Select and group rows, and write tables of them: texts of numbers, and notes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar

from foretouch.tactile import MODALITIES
from foretouch_lab.experiments.framework.experiment import Table

ALL_OBJECTS: Final = "all"  # value of the column `object` for all objects together

R = TypeVar("R", bound=Mapping[str, Any])

SIGNS: Final = {"better": "▲", "worse": "▼", "tie": "="}  # by verdict of a comparison


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


def interval_text(row: Mapping[str, Any], column: str, verdict: str, between: str) -> str:
    """Return the value of a column with the sign of a comparison and its interval, as far as the row holds them.

    Args:
        row: With the columns `<column>`, `<column>_low` and `<column>_high`.
        column: Name of the value.
        verdict: Column of the comparison.
        between: Text before the interval.
    """
    text = f"{short(row[column])} {SIGNS.get(row[verdict] or '', '')}".rstrip()
    low, high = row[f"{column}_low"], row[f"{column}_high"]
    return text if low is None else f"{text}{between}[{short(low)}, {short(high)}]"


def with_notes(tables: Sequence[Table], notes: Sequence[str]) -> list[Table]:
    """Return tables with notes below the last one."""
    return [*tables[:-1], replace(tables[-1], notes=notes)]
