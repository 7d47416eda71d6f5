# SPDX-License-Identifier: Apache-2.0
"""Tables that fit: nothing is cut at any width, and numbers stay whole as long as a word fits."""

from __future__ import annotations

from every_case import every_case
from rich.console import Console

from foretouch.cli.screen import FittedTable

COLUMNS = ["finger", "value", "span of the electrodes", "why"]
ROWS = [["thumb", "2931 ±158", "2737–3487 ±179", "adapted to three touches"], ["middle", "1858 ±99", "–", ""]]


def drawn(table: FittedTable, width: int) -> str:
    console = Console(width=width, color_system=None)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


def test_nothing_is_cut_and_words_are_whole_as_long_as_they_fit() -> None:
    words = {word for row in [COLUMNS, *ROWS] for cell in row for word in cell.split()}
    digits = sum(character.isdigit() for row in ROWS for cell in row for character in cell)

    def check(width: int, live: bool) -> None:
        text = drawn(FittedTable(COLUMNS, ROWS, live=live), width)
        assert max(map(len, text.splitlines())) <= width
        assert "…" not in text
        assert sum(character.isdigit() for character in text) == digits
        shown = {word for line in text.splitlines() for word in line.replace("│", " ").replace("┃", " ").split()}
        assert shown >= words or width < (50 if live else 24)

    every_case([(width, live) for width in (8, 15, 24, 30, 40, 50, 60, 80, 120) for live in (False, True)], check)


def test_frames_go_before_words_are_folded_and_columns_before_words_are() -> None:
    table = FittedTable(COLUMNS, ROWS)
    assert "┃" in drawn(table, 90)
    beside = drawn(table, 70)
    assert "┃" not in beside
    assert len(beside.splitlines()) == 3
    listed = drawn(table, 24).splitlines()
    assert [line.split() for line in listed[:2]] == [["finger", "thumb"], ["value", "2931", "±158"]]
    assert not all(line.strip() for line in listed), "rows stand apart"


def test_numbers_end_at_the_right_and_rows_beyond_the_limit_are_counted() -> None:
    lines = drawn(FittedTable(["a", "count", "of what"], [["x", "7", "3 touches"], ["y", "1234", "one"]]), 60)
    cells = [line.split("│")[2:4] for line in lines.splitlines() if "│" in line]
    assert cells == [["     7 ", " 3 touches "], ["  1234 ", " one       "]]
    text = drawn(FittedTable(["k"], [[str(k)] for k in range(20)], limit=3, title="numbers"), 40)
    assert "and 17 more" in text
    assert text.startswith("numbers")
    assert drawn(FittedTable(["k"], []), 40)
