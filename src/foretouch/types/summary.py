# SPDX-License-Identifier: Apache-2.0
"""How the public types are printed: a title and a few lines of facts, whatever they hold."""

import html
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import UnknownAttributeError, escaped, nearest, shown

_LINES: Final = 9  # of facts
_COLUMNS: Final = 100
_NAMES: Final = 6  # of a list

_INSTEAD: Final = {
    ("Cloud", "points"): "cloud.xyz", ("Cloud", "colors"): "cloud.rgb", ("Object", "points"): "object.cloud.xyz",
    ("Object", "mask"): "scene.labels == int(object.id)", ("Object", "center"): "object.centroid",
    ("Prediction", "values"): "prediction.value.values", ("Predictions", "values"): "predictions.value",
}  # fmt: skip
"""What users may look for, by type and name, and what it is called."""

_Facts = Mapping[str, Any]


class Summarised:
    """Base of public types: they are printed as a summary, and refuse unknown names in one line with a cure.

    By default the summary lists the fields of a dataclass.
    """

    __slots__ = ()

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):  # what Python and libraries ask for
                raise AttributeError(f"{type(self).__name__} has no {name}")
            known = [each for each in dir(self) if not each.startswith("_")]
            meant = self._instead(name)
            cure = f"; write {meant}" if meant else nearest(name, known, 0.6) or f"; there are {', '.join(known)}"
            raise UnknownAttributeError(f"{type(self).__name__}: has no {name}{cure}")

    def _instead(self, name: str) -> str:
        """Return what to write in place of an attribute that is not there; "" where nothing is known."""
        return next(filter(None, (_INSTEAD.get((kind.__name__, name), "") for kind in type(self).__mro__)), "")

    def _summary(self) -> tuple[str, _Facts]:
        """Return the title, and facts by name; one that is "" or None is left out."""
        return "", {info.name: briefly(getattr(self, info.name)) for info in fields(self)}  # type: ignore[arg-type]

    def __repr__(self) -> str:
        return summary_text(type(self).__name__, *self._summary())

    def _repr_html_(self) -> str:
        """Return the summary as a table, for notebooks."""
        title, rows = _lines(*self._summary())
        body = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in rows)
        head = f"<b>{type(self).__name__}</b> {html.escape(title)}"
        return f"<div>{head}<table>{body}</table></div>" if rows else f"<div>{head}</div>"


def summary_text(name: str, title: str, facts: _Facts) -> str:
    """Return a summary as text: at most 10 lines of 100 characters."""
    title, rows = _lines(title, facts)
    width = max((len(label) for label, _ in rows), default=0)
    lines = [f"{name}({title})", *(f"  {label:<{width}}  {text}" for label, text in rows)]
    return "\n".join(_cut(line, _COLUMNS) for line in lines)


def _lines(title: str, facts: _Facts) -> tuple[str, list[tuple[str, str]]]:
    rows = [(_cut(escaped(name), 30), escaped(str(fact))) for name, fact in facts.items() if fact not in ("", None)]
    if len(rows) > _LINES:
        more = names_of([name for name, _ in rows[_LINES - 1 :]])
        rows = [*rows[: _LINES - 1], ("and", more)]
    return escaped(title), rows


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"


def briefly(value: Any) -> str:
    """Describe a value in a few words: an array by shape and type, a collection by its size, others as Python prints them."""
    if isinstance(value, np.ndarray):
        return str(value.round(3).tolist()) if value.size <= 4 and value.dtype.kind in "fiu" else (
            f"{value.shape} {value.dtype}"
        )  # fmt: skip
    if isinstance(value, Summarised):
        return f"{type(value).__name__}({value._summary()[0]})"  # noqa: SLF001  of this class
    if isinstance(value, Mapping):
        return names_of(list(value))
    if isinstance(value, Sequence) and not isinstance(value, str):
        kinds = {type(one).__name__ for one in value[:_NAMES]}
        return names_of(value) if kinds <= {"str", "int", "float"} else f"{len(value)} x {' or '.join(sorted(kinds))}"
    return shown(value, 80)


def names_of(names: Sequence[Any]) -> str:
    """List names, the first of many."""
    listed = ", ".join(shown(name, 30) for name in names[:_NAMES])
    return f"{listed} and {len(names) - _NAMES} more" if len(names) > _NAMES else listed


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, such as `1 object` and `2 objects`."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def tallied(texts: Iterable[Any]) -> str:
    """Return how often each text occurs, such as `ok 3, bad_grasp 1`; "" of none."""
    return names_of([f"{text} {count:,}" for text, count in Counter(texts).most_common()])


def spread(values: npt.ArrayLike, text: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return the finite numbers of an array as `least to largest`, or as one number; "" of none."""
    numbers = np.asarray(values, np.float64)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return ""
    ends = list(dict.fromkeys(text(float(end)) for end in (numbers.min(), numbers.max())))
    return " to ".join(ends)
