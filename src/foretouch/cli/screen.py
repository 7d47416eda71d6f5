# SPDX-License-Identifier: Apache-2.0
"""Tables and panels that fit terminals of any size, and the live screen of `run` and `record`.

Tables fold between words, and nothing is cut. Where the words do not fit side by side with frames, the frames go; where
they still do not, each row is a list of names and values. Columns of numbers end at the right.
"""

import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from rich.box import HEAVY_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from foretouch.errors import escaped

_NUMBER = re.compile(r"[-+–]?\d(?!.*[a-z]{3})|–?$")
_REFRESH_S = 0.2
_STDERR = 2


def terminal(*, stderr: bool = False) -> Console:
    """The terminal, or what stands in for it, as rich draws on it; a closed pipe raises as it does for `print`."""
    return _Terminal(stderr=stderr)


class _Terminal(Console):
    def on_broken_pipe(self) -> None:
        raise  # noqa: PLE0704  rich calls this from the handler


def _wait(timeout_s: float) -> bool:
    time.sleep(timeout_s)
    return True


def watch(
    ended: Callable[[], bool],
    draw: Callable[[], RenderableType] | None,
    report: Callable[[], None],
    every_s: float,
    wait: Callable[[float], bool] = _wait,
) -> None:
    """Redraw until something has ended; if nothing is or can be drawn, report every so often instead.

    The drawing is on the alternate screen of the terminal, and leaves nothing behind. What libraries write to stderr
    meanwhile would tear it; it is printed afterwards. `wait` waits for so long [s], or until there is something to draw;
    it is False while there is no screen to draw on.
    """
    console = terminal()
    if draw is not None and console.is_terminal and not console.is_dumb_terminal:
        with _kept_messages(), Live(console=console, screen=True, auto_refresh=False) as live:
            visible = True
            while not ended():
                if visible:
                    live.update(draw(), refresh=True)
                visible = wait(_REFRESH_S)
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


@dataclass
class FittedTable:
    """A table that rich draws as wide as there is room for."""

    columns: Sequence[str]  # heads
    rows: Sequence[Sequence[str | Text]]  # cells, as many as columns; text is drawn as it is, without markup
    title: str = ""  # line above the table
    live: bool = False  # without frames, over all of the width, and never as lists
    limit: int = 1_000_000  # of the rows that are shown; how many more there are is written below them

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Choose the widths for the room that there is."""
        words, lines = self._spans()
        bare = options.max_width - (len(words) - 1)
        room = bare - 2 * len(words) - 2  # with frames
        framed = not self.live and (sum(lines) <= room or (sum(lines) > bare and sum(words) <= room))
        widths = _widths(words, lines, room if framed else bare)
        high = any(line > 4 * width for line, width in zip(lines, widths, strict=True))
        if self.title:
            yield Text(self.title, "italic")
        if not self.live and len(words) > 2 and (sum(words) > bare or high):
            yield from self._lists()
        else:
            yield self._table(widths, framed=framed)
        if self.limit < len(self.rows):
            yield Text(f"and {len(self.rows) - self.limit} more")

    def _spans(self) -> tuple[list[int], list[int]]:
        """Widths of the longest word and of the longest line of each column."""
        cells = [list(map(str, column)) for column in zip(self.columns, *self.rows, strict=True)]
        words = [max((len(word) for cell in column for word in cell.split()), default=0) for column in cells]
        lines = [max((len(line) for cell in column for line in cell.splitlines()), default=0) for column in cells]
        if self.live:
            return [
                min(word, 24) for word in words
            ], lines  # longer ones, such as paths and hashes, are folded anywhere
        return [lines[0] if lines[0] <= 36 else words[0], *words[1:]], lines  # names in the first column are not broken

    def _table(self, widths: Sequence[int], *, framed: bool) -> Table:
        padding = (0, 1) if framed else (0, 1, 0, 0)
        table = Table(box=HEAVY_HEAD if framed else None, expand=self.live, padding=padding, pad_edge=framed)
        for k, (name, width) in enumerate(zip(self.columns, widths, strict=True)):
            numbers = k > 0 and all(_NUMBER.match(str(row[k])) for row in self.rows)
            table.add_column(Text(name), width=width, justify="right" if numbers else "left", overflow="fold")
        for row in self.rows[: self.limit]:
            table.add_row(*map(_text, row))
        return table

    def _lists(self) -> RenderResult:
        for number, row in enumerate(self.rows[: self.limit]):
            if number:
                yield Text("")
            grid = Table.grid(padding=(0, 1, 0, 0))
            grid.add_column(style="bold", overflow="fold")
            grid.add_column(overflow="fold")
            for name, cell in zip(self.columns, row, strict=True):
                if str(cell):
                    grid.add_row(Text(name), _text(cell))
            yield grid


def _text(cell: str | Text) -> Text:
    return Text(escaped(cell, keep="\n")) if isinstance(cell, str) else cell


def _widths(words: Sequence[int], lines: Sequence[int], room: int) -> list[int]:
    """Widths of columns from those of their longest words and lines: what is left is shared by those that fold."""
    if sum(lines) <= room:
        return list(lines)
    widths = list(words)
    while sum(widths) > room:
        widths[widths.index(max(widths))] -= 1
    wishes = [max(line - width, 0) for line, width in zip(lines, widths, strict=True)]
    left = room - sum(widths)
    return [width + left * wish // sum(wishes) for width, wish in zip(widths, wishes, strict=True)]


@dataclass
class FittedPanel:
    """A panel whose parts are left out from the last one, as far as the screen is too low for all; tables lose rows."""

    parts: list[RenderableType]  # in order of importance
    title: str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw as many parts as fit; all where the height is not limited."""
        title, parts = self.title, list(self.parts)
        if len(title) > options.max_width - 6:  # beside corners, lines and spaces rich would cut it
            title, parts = "", [Text(title, "bold", overflow="fold"), *parts]
        if options.height is not None:
            inner = options.update(width=options.max_width - 4, height=None)
            room, fitting = options.height - 2, []
            for part in parts:
                height = len(console.render_lines(part, inner, pad=False))
                if isinstance(part, FittedTable):
                    part.limit = min(part.limit, len(part.rows))
                    while height > room and part.limit > 1:
                        part.limit -= 1
                        height = len(console.render_lines(part, inner, pad=False))
                room -= height
                if room < 0:
                    break
                fitting.append(part)
            parts = fitting
        yield Panel(Group(*parts), title=title or None, title_align="left")
