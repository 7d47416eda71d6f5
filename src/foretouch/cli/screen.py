# SPDX-License-Identifier: Apache-2.0
"""The live screen of `run` and `record`."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from foretouch.cli.output import terminal
from foretouch.cli.tables import FittedTable

_STDERR = 2
_TITLE_MARGIN = 6  # corners, lines and spaces


def can_draw() -> bool:
    """Whether stdout is a terminal whose cursor can be moved."""
    console = terminal()
    return console.is_terminal and not console.is_dumb_terminal


def draw_until(ended: Callable[[], bool], draw: Callable[[], RenderableType], period_s: float) -> None:
    """Redraw until something has ended.

    The drawing is on the alternate screen of the terminal, and leaves nothing behind. What libraries write to stderr
    meanwhile would tear it; it is printed afterwards.
    """
    with _kept_messages(), Live(console=terminal(), screen=True, auto_refresh=False) as live:
        while not ended():
            live.update(draw(), refresh=True)
            time.sleep(period_s)


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
class FittedPanel:
    """A panel whose parts are left out from the last one, as far as the screen is too low for all; tables lose rows."""

    parts: list[RenderableType]  # in order of importance
    title: str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw as many parts as fit; all where the height is not limited."""
        title, parts = self.title, list(self.parts)
        if len(title) > options.max_width - _TITLE_MARGIN:  # rich would cut it
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
