# SPDX-License-Identifier: Apache-2.0
"""Tables that fit terminals of any width: they fold between words, and nothing is cut.

Where the columns do not fit side by side with frames, the frames go; where they still do not, each row is a list of
names and values. Columns of numbers end at the right.
"""

import re
from collections.abc import Sequence

from rich.box import HEAVY_HEAD, Box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

Cell = str | Text

_NUMBER = re.compile(r"[-+–]?\d(?!.*[a-z]{3})|–?$")
_MOST_FOLDS = 4.0
_LONGEST_WORD = 24  # longer ones, such as paths and hashes, may be folded anywhere


class FittedTable:
    """A table that rich draws as wide as there is room for.

    Args:
        columns: Heads.
        rows: Cells, as many as columns; text is drawn as it is, without markup.
        title: Line above the table.
        box: Frames, where there is room for them; None for none.
        expand: Whether all of the width is used.
        listed: Whether rows become lists where columns do not fit; otherwise their words are folded.
        limit: Number of rows that are shown; how many more there are is written below them.
    """

    def __init__(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[Cell]],
        *,
        title: str = "",
        box: Box | None = HEAVY_HEAD,
        expand: bool = False,
        listed: bool = True,
        limit: int | None = None,
    ) -> None:
        self._title = title
        self._columns = [Text(name) for name in columns]
        self.limit = len(rows) if limit is None else min(limit, len(rows))
        self._rows = [[cell if isinstance(cell, Text) else Text(cell) for cell in row] for row in rows]
        self._box = box
        self._expand = expand
        self._listed = listed

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Choose the widths for the room that there is."""
        spans = [
            self._span(console, options, [name, *(row[k] for row in self._rows)])
            for k, name in enumerate(self._columns)
        ]
        least, most = (sum(span[end] for span in spans) for end in (0, 1))
        bare = options.max_width - (len(spans) - 1)
        framed = options.max_width - 3 * len(spans) - 1 if self._box is not None else -1
        frames = most <= framed or (most > bare and least <= framed)
        widths = _widths(spans, framed if frames else bare)
        if self._title:
            yield Text(self._title, "italic")
        if self._listed and (least > bare or self._folds(widths) > _MOST_FOLDS):
            yield from self._lists()
        else:
            yield self._table(widths, self._box if frames else None)
        if self.limit < len(self._rows):
            yield Text(f"and {len(self._rows) - self.limit} more")

    @staticmethod
    def _span(console: Console, options: ConsoleOptions, cells: Sequence[Text]) -> tuple[int, int]:
        """Widths of the longest word and of the longest line."""
        found = [Measurement.get(console, options.update(max_width=10_000), cell) for cell in cells]
        most = max(one.maximum for one in found)
        return min(max(one.minimum for one in found), _LONGEST_WORD), most

    def _folds(self, widths: Sequence[int]) -> float:
        """About how many lines the highest cell has."""
        return max(
            (cell.cell_len / width for row in self._rows for cell, width in zip(row, widths, strict=True)), default=0
        )

    def _table(self, widths: Sequence[int], box: Box | None) -> Table:
        padding = (0, 1) if box is not None else (0, 1, 0, 0)
        table = Table(box=box, expand=self._expand, padding=padding, pad_edge=box is not None)
        for k, (name, width) in enumerate(zip(self._columns, widths, strict=True)):
            numbers = k > 0 and all(_NUMBER.match(row[k].plain) for row in self._rows)
            table.add_column(name, width=width, justify="right" if numbers else "left", overflow="fold")
        for row in self._rows[: self.limit]:
            table.add_row(*row)
        return table

    def _lists(self) -> RenderResult:
        for number, row in enumerate(self._rows[: self.limit]):
            if number:
                yield Text("")
            grid = Table.grid(padding=(0, 1, 0, 0))
            grid.add_column(style="bold", overflow="fold")
            grid.add_column(overflow="fold")
            for name, cell in zip(self._columns, row, strict=True):
                if cell.plain:
                    grid.add_row(name, cell)
            yield grid


def _widths(spans: Sequence[tuple[int, int]], room: int) -> list[int]:
    """Widths of columns from those of their longest words and lines: what is left is shared by those that fold."""
    most = [high for _, high in spans]
    if sum(most) <= room:
        return most
    widths = [low for low, _ in spans]
    while sum(widths) > room:
        widths[widths.index(max(widths))] -= 1
    wishes = [high - width for high, width in zip(most, widths, strict=True)]
    left = room - sum(widths)
    return [width + left * wish // sum(wishes) for width, wish in zip(widths, wishes, strict=True)]
