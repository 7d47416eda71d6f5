# SPDX-License-Identifier: Apache-2.0
"""The table "to add something" of docs/architecture.md: its files exist, and are as few as promised."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST_FILES = {
    "tactile message type": 2,
    "touch model": 3,
    "dataset format": 2,
    "experiment": 1,
    "tradeoff area": 1,
    "node": 3,
}


def rows() -> dict[str, tuple[list[Path], list[Path]]]:
    """Files to touch and tests, by what is added."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = text.partition("## To add something")[2].partition("\n## ")[0]
    found = {}
    for line in table.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| a"):
            name = re.sub(r"^an? ", "", cells[0])
            touched, tests = ([ROOT / path for path in re.findall(r"`([\w/]+\.py)`", cell)] for cell in cells[1:])
            found[name] = (touched, tests)
    return found


def test_the_table_lists_everything_that_can_be_added() -> None:
    assert rows().keys() == MOST_FILES.keys()


@pytest.mark.parametrize("name", MOST_FILES)
def test_files_and_tests_exist_and_are_few(name: str) -> None:
    touched, tests = rows()[name]
    assert touched
    assert tests
    assert [str(path) for path in (*touched, *tests) if not path.is_file()] == []
    assert len(touched) <= MOST_FILES[name]


def test_each_table_of_the_code_is_named_once() -> None:
    """A list of supported types that was written a second time would have to be touched as well."""
    source = "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "src").rglob("*.py")))
    for table in ("TACTILE_TYPES", "KINDS", "FORMATS", "LEARNERS"):
        assert len(re.findall(rf"^{table}\b.*=", source, re.MULTILINE)) == 1, table
