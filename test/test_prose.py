# SPDX-License-Identifier: Apache-2.0
"""The English of the documents: sentences are short, and some phrases that read like a translation are rare.

Counted is running text: no headings, tables, code, link targets or captions of images. Generated pages are left out.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PHRASES = (
    "that of",
    "those of",
    "those that",
    "so many",
    "of its own",
    "there is none",
    "as of a",
    "is none",
    "are none",
)
LEFT_OUT = re.compile(r"^ *```.*?^ *```$|<!--.*?-->|^(?:\||#).*?$|!\[[^\]]*\]\([^)]*\)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
BLOCK = re.compile(r"\n\s*\n|^\s*(?:[-*]|\d+\.) ", re.MULTILINE)
SENTENCE = re.compile(r"(?<=[.!?])[)\"]? +(?=[A-Z(\[\"])")


def pages() -> list[Path]:
    return [page for page in sorted(DOCS.rglob("*.md")) if not {"results", "reference"} & set(page.parts)]


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of running text; code in a line is one word."""
    prose = LINK.sub(r"\1", re.sub(r"`[^`\n]*`", "Code", LEFT_OUT.sub("\n\n", text))).replace("*", "")
    for block in BLOCK.split(prose):
        yield from filter(lambda sentence: re.search(r"\w", sentence), SENTENCE.split(" ".join(block.split())))


def newest_changes() -> str:
    """The section of the newest version in the changelog."""
    return (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## [", 2)[1]


def test_what_a_sentence_is() -> None:
    text = "# Not this\nOne [two](three.md) `four five` six. Seven\neight? *Nine.*\n\n- Ten: 0.5 eleven\n- twelve\n\n| no | no |\n"
    assert list(sentences(text)) == ["One two Code six.", "Seven eight?", "Nine.", "Ten: 0.5 eleven", "twelve"]


@pytest.mark.parametrize(
    ("texts", "mean", "long"),
    [
        ([(ROOT / "README.md").read_text(encoding="utf-8")], 17.0, 0.0),
        ([page.read_text(encoding="utf-8") for page in pages()], 18.0, 0.03),
        ([newest_changes()], 15.0, 0.03),
        ([(DOCS / "results" / "README.md").read_text(encoding="utf-8")], 18.0, 0.03),
    ],
    ids=["README", "pages", "changelog", "results"],
)
def test_sentences_are_short(texts, mean, long) -> None:
    words = {
        sentence: sum(bool(re.search(r"\w", word)) for word in sentence.split())
        for text in texts
        for sentence in sentences(text)
    }
    assert sum(words.values()) / len(words) <= mean
    over = [sentence for sentence, count in words.items() if count > 30]
    assert len(over) / len(words) <= long, "\n".join(over)


def test_few_phrases_read_like_a_translation() -> None:
    pattern = re.compile(rf"\b(?:{'|'.join(PHRASES)})\b", re.IGNORECASE)
    found = {
        str(page.relative_to(ROOT)): hits
        for page in [ROOT / "README.md", *pages(), DOCS / "results" / "README.md"]
        if (hits := pattern.findall(" ".join(page.read_text("utf-8").split())))
    }
    assert sum(map(len, found.values())) <= 2, found


def test_numbers_have_a_leading_zero() -> None:
    bare = re.compile(r"(?<![\w.\]/`\"'])\.\d")
    found = {
        str(page.relative_to(ROOT)): hits
        for page in [ROOT / "README.md", *pages(), DOCS / "results" / "README.md"]
        if (
            hits := bare.findall(
                re.sub(r"```.*?```|`[^`\n]*`|\]\([^)]*\)", "", page.read_text("utf-8"), flags=re.DOTALL)
            )
        )
    }
    assert not found
