# SPDX-License-Identifier: Apache-2.0
"""Options that take a number: what no command can use is refused before anything starts."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_answer import Answer

from foretouch.cli.main import COMMANDS, _parser

MAY_BE_ZERO = {"--seed", "--vary", "--wait-limit"}
CHECKED_LATER = {"grasp --tip-mm": "tip_mm", "grasp --count": "count", "grasp --slide-m": "slide_m"}
"""Options whose bounds are those of a setting, and its name in the error."""


def numeric_options(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from numeric_options(below)
        elif action.type is not None and _takes_a_number(action.type):
            yield f"{parser.prog.removeprefix('foretouch ')} {action.option_strings[-1]}", action


def _takes_a_number(kind: Callable[[str], object]) -> bool:
    try:
        return isinstance(kind("7"), int | float)
    except argparse.ArgumentTypeError:  # such as four numbers
        return False


OPTIONS = {
    name: action
    for command in COMMANDS
    for name, action in numeric_options(_parser(command))
    if name not in CHECKED_LATER
}


def test_the_options_are_found() -> None:
    assert {"record --seconds", "run --count", "replay --rate", "dataset build --seed", "predict --budget-ms"} <= set(
        OPTIONS
    )


@pytest.mark.parametrize("text", ["-1", "0", "nan", "inf", "1e999", "x", ""])
@pytest.mark.parametrize("name", OPTIONS)
def test_a_number_that_cannot_be_used_is_refused_by_the_parser(name: str, text: str) -> None:
    kind = OPTIONS[name].type
    assert callable(kind)
    if text == "0" and any(name.endswith(option) for option in MAY_BE_ZERO):
        assert kind(text) == 0
        return
    with pytest.raises(argparse.ArgumentTypeError, match=f"{text!r} is not |{text} is not "):
        kind(text)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("record", "-o", "none", "--seconds", "-1"), "argument --seconds: -1 is not above 0"),
        (("run", "--source", "none", "--count", "0"), "argument --count: 0 is not 1 or more"),
        (("replay", "none", "--rate", "fast"), "argument --rate: 'fast' is not a finite number"),
        (("train", "none", "-o", "none", "--workers", "2.5"), "argument --workers: '2.5' is not a whole number"),
    ],
)
def test_the_command_names_option_and_rule_in_one_line(
    call: Callable[..., Answer], capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    with pytest.raises(SystemExit, match="2"):
        call(*words)
    assert capsys.readouterr().err.splitlines()[-1] == f"foretouch {words[0]}: error: {message}"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("grasp --tip-mm", "nan"),
        ("grasp --tip-mm", "-5"),
        ("grasp --tip-mm", "0"),
        ("grasp --count", "-5"),
        ("grasp --count", "0"),
        ("grasp --slide-m", "nan"),
        ("grasp --slide-m", "inf"),
    ],
)
def test_a_setting_is_refused_in_one_line(call: Callable[..., Answer], files: Path, name: str, text: str) -> None:
    command, option = name.split()
    answer = call(command, files / "object.pcd", option, text)
    (line,) = answer.err.splitlines()
    assert answer.status == 1
    assert CHECKED_LATER[name] in line
