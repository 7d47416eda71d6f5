# SPDX-License-Identifier: Apache-2.0
"""Output of the commands: JSON lines or tables on stdout, progress bars and warnings on stderr."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from foretouch.errors import escaped


def print_json(record: Mapping[str, Any]) -> None:
    """Print one line on stdout and flush it. Numbers that are not finite become null."""
    utf8 = (sys.stdout.encoding or "").lower() in {"utf-8", "utf8"}
    sys.stdout.write(json.dumps(_plain(record), allow_nan=False, ensure_ascii=not utf8) + "\n")
    sys.stdout.flush()


def print_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """Print a title and, if there are rows, a table; the caller formats numbers and units."""
    from foretouch.cli.screen import make_table, terminal

    print_text(title, "bold")
    if rows:
        terminal().print(make_table(columns, rows))


def print_text(text: str, style: str = "") -> None:
    """Print a paragraph, folded between words on a terminal; in a pipe, a line stays a line."""
    from foretouch.cli.screen import terminal

    console = terminal()
    console.print(
        escaped(text, keep="\n"), style=style, highlight=False, markup=False, soft_wrap=not console.is_terminal
    )


def announce(wait: str) -> None:
    """Say on stderr what a person at a terminal is going to wait for."""
    if sys.stderr.isatty():
        warn(wait)


@contextmanager
def progress_bar(description: str, total: int | None = None, *, hidden: bool = False) -> Iterator[Callable[..., None]]:
    """Show a progress bar with elapsed and remaining time on stderr while the block runs, unless it is `hidden` or stderr no terminal.

    `total` is the number of steps, if it is known.

    Yields:
        `update(completed=None, total=None, description=None)`, which advances by one step without `completed`.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    from foretouch.cli.screen import terminal

    console = terminal(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(), "{task.description}")
    with Progress(*columns, console=console, transient=True, disable=hidden or not console.is_terminal) as bar:
        task = bar.add_task(description, total=total)

        def update(completed: int | None = None, total: int | None = None, description: str | None = None) -> None:
            advance = 1 if completed is None else None
            bar.update(task, completed=completed, advance=advance, total=total, description=description)

        yield update


def warn(message: str) -> None:
    """Print one line on stderr."""
    print(f"foretouch: {escaped(message)}", file=sys.stderr)


def _plain(value: Any) -> Any:
    """Convert arrays, mappings and numbers to JSON types."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
