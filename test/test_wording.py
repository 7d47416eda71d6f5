# SPDX-License-Identifier: Apache-2.0
"""Words that were retired do not come back: code, help, messages and documents use the terms of the field.

`retired_words.txt` lists each retired word with the term that replaces it. Keys that are part of an interface (ROS parameters, YAML, JSON,
card and diagnostics keys, CSV headers) may keep an old word: they stand alone in quotes, which is not searched.
Committed results and the changelog are records of the past and are not searched either.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = tuple(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").glob("*.md")))
SEARCHED = ("src", "launch", "examples", "README.md", *PAGES, "docs/tutorials", "docs/reference", "docs/_ext")
_KEY = re.compile(
    r"""(["'`])[\w./:]+\1|\*[A-Za-z][^*]+\*|\.tell\(\)"""
)  # names in quotes or backticks, *titles* and `file.tell()`


CSV_VALUES = {  # written in committed results
    ("src/foretouch/experiments/ablation/results.py", "leaned")
}


def retired() -> dict[str, str]:
    """Replacement by retired word."""
    lines = (ROOT / "test" / "retired_words.txt").read_text(encoding="utf-8").splitlines()
    pairs = (line.split("|") for line in lines if line.strip() and not line.startswith("#"))
    return {word.strip(): term.strip() for word, term in pairs}


def findings(text: str, words: dict[str, str]) -> list[tuple[int, str]]:
    """(line, retired word) for each occurrence outside of quoted keys."""
    pattern = re.compile(r"(?<![\w])(" + "|".join(map(re.escape, sorted(words, key=len, reverse=True))) + r")(?![\w])")
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        found += [(number, match[1]) for match in pattern.finditer(_KEY.sub('""', line))]
    return found


def searched_files() -> list[Path]:
    """All files that the words are searched in."""
    files = []
    for name in SEARCHED:
        path = ROOT / name
        files += sorted([*path.rglob("*.py"), *path.rglob("*.md")]) if path.is_dir() else [path]
    return files


def test_no_retired_word_is_used() -> None:
    words = retired()
    messages = [
        f"{path.relative_to(ROOT)}:{number}: {word!r} is retired; use {words[word]!r}"
        for path in searched_files()
        for number, word in findings(path.read_text(encoding="utf-8"), words)
        if (str(path.relative_to(ROOT)), word) not in CSV_VALUES
    ]
    assert not messages, "\n" + "\n".join(messages)


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("# tells the operator", 1),
        ('record["tells"] = 1  # a key', 0),
        ("def tells_apart(): ...", 0),
        ("whoever tells", 2),
    ],
)
def test_words_are_found_but_keys_are_not(line: str, count: int) -> None:
    assert len(findings(line, {"tells": "reports", "whoever": "the caller"})) == count
