# SPDX-License-Identifier: Apache-2.0
"""How the actions of `foretouch dataset` tell what they do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from foretouch.cli.output import print_json, print_table

__all__ = ["counted", "progress", "tell"]


@contextmanager
def progress(what: str, *, as_json: bool) -> Iterator[Callable[[], None]]:
    """A count on stderr while something goes on; nothing for a program that reads JSON."""
    if as_json:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn(f"{what}: {{task.completed}} samples"), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda: bar.advance(task)


def tell(title: str, record: Mapping[str, Any], *, as_json: bool) -> None:
    """What became of it: a JSON object, or a table without what is empty."""
    if as_json:
        print_json(record)
        return
    rows = [[name.replace("_", " "), _text(value)] for name, value in record.items() if value not in ({}, [], "")]
    print_table(title, ["", "value"], rows)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {_text(item)}" for name, item in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def counted(counts: Mapping[str, int]) -> str:
    """Names with their counts."""
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
