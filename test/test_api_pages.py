# SPDX-License-Identifier: Apache-2.0
"""The examples of docs/api print what the pages show; numbers other than shapes may differ by a tenth."""

import ast
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import foretouch as ft

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import api_pages  # noqa: E402

NUMBER = re.compile(r"-?\d+\.?\d*")
RANGE_END = re.compile(r" to -?\d+\.?\d*(?= |$)", re.MULTILINE)  # a range of equal ends is one number: rounding decides
SHAPE = re.compile(r"\([\d, ]+\)")


def form(text: str) -> str:
    """Return a text with # for each number and each range."""
    return NUMBER.sub("#", RANGE_END.sub("", text))


@pytest.mark.parametrize("page", api_pages.PAGES, ids=lambda page: page.stem)
def test_the_examples_print_what_the_page_shows_and_draw_its_picture(page: Path, tmp_path: Path) -> None:
    for code, *texts in api_pages.run(page, tmp_path):
        printed, shown = (RANGE_END.sub("", text) for text in texts)
        assert form(printed) == form(shown), code
        assert SHAPE.findall(printed) == SHAPE.findall(shown), code
        mine, theirs = (np.array(NUMBER.findall(text), float) for text in (printed, shown))
        np.testing.assert_allclose(mine, theirs, rtol=0.1, atol=0.11)
    pictures = re.findall(r"!\[.+\]\((\w+\.png)\)", page.read_text(encoding="utf-8"))
    for picture in pictures:
        assert (tmp_path / "api" / picture).stat().st_size > 5_000
        assert (page.parent / picture).is_file()


def test_every_class_of_the_front_door_is_on_a_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in api_pages.PAGES)
    listed = set(re.findall(r"\w+", " ".join(re.findall(r"(?::members:|autoclass::) (.+)", text))))
    whole = re.findall(r"automodule:: (\S+)\n +:members:\n", text)
    classes = [entry for entry in (getattr(ft, name) for name in ft.__all__) if isinstance(entry, type)]
    assert not [kind for kind in classes if kind.__name__ not in listed and kind.__module__ not in whole]


def test_the_ten_tasks_take_forty_lines() -> None:
    index = ROOT / "docs" / "api" / "index.md"
    assert len(re.findall(r"^## \d+\. ", index.read_text(encoding="utf-8"), re.MULTILINE)) == 10
    assert api_pages.code_lines(index) <= 40


def test_the_notebook_runs_and_shows_what_it_holds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("pandas", "xarray"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    notebook = json.loads((ROOT / "examples" / "touch.ipynb").read_text(encoding="utf-8"))
    monkeypatch.chdir(ROOT / "examples")
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        program = ast.parse("".join(cell["source"]))
        last = program.body.pop() if isinstance(program.body[-1], ast.Expr) else None
        exec(compile(program, "cell", "exec"), names)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None
        printed = capsys.readouterr().out
        shown = {"text": "", "plain": ""}
        for out in cell["outputs"]:
            shown["text"] += "".join(out.get("text", ()))
            shown["plain"] += "".join(out.get("data", {}).get("text/plain", ()))
        assert form(printed) == form(shown["text"])
        if value is not None and not hasattr(value, "savefig"):
            assert form(repr(value)).split() == form(shown["plain"]).split()
