# SPDX-License-Identifier: Apache-2.0
"""Output of the commands: JSON lines or tables on stdout, progress bars and warnings on stderr."""

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from foretouch.base.bounded_queue import BoundedQueue
from foretouch.errors import escaped
from foretouch.types.arrays import plain


def print_json(record: Mapping[str, Any]) -> None:
    """Print one line on stdout and flush it. Numbers that are not finite become null."""
    utf8 = (sys.stdout.encoding or "").lower() in {"utf-8", "utf8"}
    sys.stdout.write(json.dumps(plain(record), allow_nan=False, ensure_ascii=not utf8) + "\n")
    sys.stdout.flush()


class JsonLines:
    """Prints records as lines of JSON in a thread, so that a reader that stops reading holds up nothing.

    Args:
        record: Makes the record of an item.
        waiting: Number of items that may wait; further ones are dropped and counted.

    Attributes:
        fault: Why no more can be printed, such as that the reader (`| head`) has exited.
    """

    def __init__(self, record: Callable[[Any], Mapping[str, Any]] = lambda item: item, waiting: int = 100) -> None:
        self.fault: OSError | None = None
        self._record = record
        self._items: BoundedQueue[Any] = BoundedQueue(waiting, when_full="reject")
        self._in_print = 0  # taken from the queue, and not printed yet
        self._utf8 = (sys.stdout.encoding or "").lower() in {"utf-8", "utf8"}
        sys.stdout.flush()
        self._file = sys.stdout.fileno()
        self._thread = threading.Thread(target=self._run, name="json", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of items that were not printed. Items that still wait are counted after `close`."""
        waits = self._in_print if self._items.closed else 0
        return self._items.dropped.total() + waits

    def put(self, item: Any) -> None:
        """Let an item wait to be printed, or drop it."""
        self._items.put(item)

    def close(self, timeout_s: float) -> bool:
        """Print what waits, for a time at most [s]; what was not read by then is dropped. Returns whether all was printed."""
        self._items.close()
        self._thread.join(timeout_s)
        self._items.close("not read")
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (item := self._items.get()) is not None:
            self._in_print = 1
            try:
                line = json.dumps(plain(self._record(item)), allow_nan=False, ensure_ascii=not self._utf8) + "\n"
                rest = line.encode()
                while rest:  # past sys.stdout: a thread that waits in it would keep Python from ending
                    rest = rest[os.write(self._file, rest) :]
            except OSError as err:
                self.fault = err
                self._items.close("not read")
                return
            self._in_print = 0


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
