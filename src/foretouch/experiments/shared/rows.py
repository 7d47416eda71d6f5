# SPDX-License-Identifier: Apache-2.0
"""Select and group rows of a table, and write their numbers."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, TypeVar

R = TypeVar("R", bound=Mapping[str, Any])

SIGNS: Final = {"better": "▲", "worse": "▼", "tie": "="}
"""By verdict of a comparison."""


def select(rows: Iterable[R], **wanted: Any) -> list[R]:
    """Rows that have the given values."""
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def grouped(rows: Iterable[R], *columns: str) -> list[tuple[Any, list[R]]]:
    """Each value of a column, or tuple of values of several, with its rows; in order of their first rows."""
    found: dict[Any, list[R]] = {}
    for row in rows:
        key = row[columns[0]] if len(columns) == 1 else tuple(row[name] for name in columns)
        found.setdefault(key, []).append(row)
    return list(found.items())


def unique(rows: Iterable[Mapping[str, Any]], column: str) -> list[Any]:
    """Values of a column, each once, in order of their first rows."""
    return list(dict.fromkeys(row[column] for row in rows))


def short(value: float | None, decimals: int = 2) -> str:
    """A number without the zero before its point; `–` for None."""
    if value is None:
        return "–"
    text = f"{value:.{decimals}f}" if abs(value) < 1.0 else f"{value:.{decimals - 1}f}"
    return text.replace("0.", ".", 1) if abs(value) < 1.0 else text


def listed(rows: Iterable[Mapping[str, Any]], column: str, decimals: int = 2) -> str:
    """Numbers of a column, such as those of the four modalities."""
    return " ".join(short(row[column], decimals) for row in rows)


def span(values: Iterable[float], decimals: int = 2) -> str:
    """The least and the largest number."""
    found = list(values)
    low, high = short(min(found), decimals), short(max(found), decimals)
    return low if low == high else f"{low} to {high}"


def enumerated(names: Sequence[str]) -> str:
    """Names joined by commas and `and`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
