# SPDX-License-Identifier: Apache-2.0
"""Tables and panels for terminals of any width, and the live screen of `run` and `record`."""

import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Literal

from rich.box import HEAVY_HEAD
from rich.console import Console, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from foretouch.errors import escaped

_NUMBER = re.compile(r"[-+–]?\d(?!.*[a-z]{3})|–?$")
_REFRESH_S = 0.2
_STDERR = 2


def terminal(*, stderr: bool = False) -> Console:
    """Return the terminal as rich draws on it, or the stream in its place; a closed pipe raises a `BrokenPipeError`, as for `print`."""
    return _Terminal(stderr=stderr)


class _Terminal(Console):
    def on_broken_pipe(self) -> None:
        raise  # noqa: PLE0704  rich calls this from the handler


def watch(
    ended: Callable[[], bool],
    draw: Callable[[], RenderableType] | None,
    report: Callable[[], None],
    every_s: float,
    wait: Callable[[float], object] = time.sleep,
) -> None:
    """Redraw until something has ended; if nothing is or can be drawn, report every so often instead.

    The drawing is on the alternate screen of the terminal, which cuts what is below its last line, and leaves nothing
    behind. What libraries write to stderr meanwhile would tear it; it is printed afterwards. `wait` waits for so long
    [s], or until there is something to draw.
    """
    console = terminal()
    if draw is not None and console.is_terminal and not console.is_dumb_terminal:
        with _kept_messages(), Live(console=console, screen=True, auto_refresh=False) as live:
            while not ended():
                live.update(draw(), refresh=True)
                wait(_REFRESH_S)
    reported = time.monotonic()
    while not ended():
        time.sleep(_REFRESH_S)
        if time.monotonic() - reported >= every_s:
            reported = time.monotonic()
            report()


@contextmanager
def _kept_messages() -> Iterator[None]:
    if not os.isatty(_STDERR):
        yield
        return
    sys.stderr.flush()
    before = os.dup(_STDERR)
    with tempfile.TemporaryFile() as kept:
        os.dup2(kept.fileno(), _STDERR)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(before, _STDERR)
            os.close(before)
            kept.seek(0)
            sys.stderr.write(kept.read().decode(errors="replace"))
            sys.stderr.flush()


def make_table(
    columns: Sequence[str], rows: Sequence[Sequence[str | Text]], title: str = "", *, live: bool = False
) -> Table:
    """Return a table whose cells are folded between words, or within words where these do not fit; columns of numbers end at the right.

    Args:
        columns: Heads.
        rows: Cells, as many as columns; text is drawn as it is, without markup.
        title: Line above the table.
        live: Without frames, over all of the width.
    """
    padding = (0, 1, 0, 0) if live else (0, 1)
    table = Table(box=None if live else HEAVY_HEAD, expand=live, padding=padding, pad_edge=not live)
    table.title, table.title_justify = (Text(title, "italic") if title else None), "left"
    for k, name in enumerate(columns):
        cells = [str(row[k]) for row in rows]
        justify: Literal["left", "right"] = "right" if k > 0 and all(map(_NUMBER.match, cells)) else "left"
        table.add_column(Text(name), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*(Text(escaped(cell, keep="\n")) if isinstance(cell, str) else cell for cell in row))
    return table
