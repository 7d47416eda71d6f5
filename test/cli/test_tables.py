# SPDX-License-Identifier: Apache-2.0
"""Tables that fit: nothing is cut at any width, and numbers stay whole as long as a word fits."""

from __future__ import annotations

import pytest
from rich.console import Console

from foretouch.cli.tables import FittedTable

COLUMNS = ["finger", "value", "span of the electrodes", "why"]
ROWS = [["thumb", "2931 ±158", "2737–3487 ±179", "adapted to three touches"], ["middle", "1858 ±99", "–", ""]]
WORDS = {word for row in [COLUMNS, *ROWS] for cell in row for word in cell.split()}


def drawn(table: FittedTable, width: int, height: int | None = None) -> str:
    console = Console(width=width, height=height, color_system=None)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


@pytest.mark.parametrize("width", [24, 30, 40, 50, 60, 80, 120])
def test_every_word_is_whole_at_every_width(width: int) -> None:
    text = drawn(FittedTable(COLUMNS, ROWS), width)
    assert max(map(len, text.splitlines())) <= width
    assert {word for line in text.splitlines() for word in line.replace("│", " ").replace("┃", " ").split()} >= WORDS


@pytest.mark.parametrize("width", [8, 15, 24])
def test_where_not_even_words_fit_they_are_folded(width: int) -> None:
    for listed in (True, False):
        text = drawn(FittedTable(COLUMNS, ROWS, listed=listed), width)
        assert "…" not in text
        assert max(map(len, text.splitlines())) <= width
        left = "".join(character for character in text if character.isdigit())
        assert len(left) == sum(character.isdigit() for row in ROWS for cell in row for character in cell)


def test_frames_go_before_words_are_folded_and_columns_before_words_are() -> None:
    table = FittedTable(COLUMNS, ROWS)
    assert "┃" in drawn(table, 90)
    beside = drawn(table, 70)
    assert "┃" not in beside
    assert len(beside.splitlines()) == 3
    listed = drawn(table, 24).splitlines()
    assert [line.split() for line in listed[:2]] == [["finger", "thumb"], ["value", "2931", "±158"]]
    assert not all(line.strip() for line in listed), "rows stand apart"


def test_numbers_end_at_the_right_and_words_begin_at_the_left() -> None:
    lines = drawn(
        FittedTable(["a", "count", "of what"], [["x", "7", "3 touches"], ["y", "1234", "one"]]), 60
    ).splitlines()
    assert [line.split("│")[2] for line in lines if "│" in line] == ["     7 ", "  1234 "]
    assert [line.split("│")[3] for line in lines if "│" in line] == [" 3 touches ", " one       "]


def test_rows_beyond_the_limit_are_counted() -> None:
    text = drawn(FittedTable(["k"], [[str(k)] for k in range(20)], limit=3, title="numbers"), 40)
    assert "and 17 more" in text
    assert text.startswith("numbers")
    assert drawn(FittedTable(["k"], []), 40)
