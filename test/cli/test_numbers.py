# SPDX-License-Identifier: Apache-2.0
"""Options that take a number: what no command can use is refused before anything starts."""

import argparse
from collections.abc import Callable, Iterator

import pytest
from every_case import every_case

from foretouch.cli.main import COMMANDS, _parser

MAY_BE_ZERO = ("--seed", "--vary", "--wait-limit")
CHECKED_LATER = {"grasp --tip-mm": "tip_mm", "grasp --count": "count", "grasp --slide-m": "slide_m"}
"""Options whose bounds are those of a setting, and its name in the error."""


def numeric_options(parser: argparse.ArgumentParser) -> Iterator[tuple[str, Callable[[str], object]]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from numeric_options(below)
        elif callable(action.type) and _takes_a_number(action.type):
            yield f"{parser.prog.removeprefix('foretouch ')} {action.option_strings[-1]}", action.type


def _takes_a_number(kind: Callable[[str], object]) -> bool:
    try:
        return isinstance(kind("7"), int | float)
    except argparse.ArgumentTypeError:  # such as four numbers
        return False


def test_a_number_that_cannot_be_used_is_refused_by_the_parser() -> None:
    options = {name: kind for command in COMMANDS for name, kind in numeric_options(_parser(command))}
    known = {"record --seconds", "run --count", "replay --rate", "dataset build --seed", "predict --budget-ms"}
    assert known | CHECKED_LATER.keys() <= set(options)

    def check(name: str, text: str) -> None:
        if text == "0" and name.endswith(MAY_BE_ZERO):
            assert options[name](text) == 0
            return
        with pytest.raises(argparse.ArgumentTypeError, match=f"{text!r} is not |{text} is not "):
            options[name](text)

    texts = ("-1", "0", "nan", "inf", "1e999", "x", "")
    every_case([(name, text) for name in options if name not in CHECKED_LATER for text in texts], check)


def test_the_command_names_option_or_setting_and_rule_in_one_line(call, capsys, files) -> None:
    def check(words: str, message: str) -> None:
        with pytest.raises(SystemExit, match="2"):
            call(*words.split())
        command, line = words.split(maxsplit=1)[0], capsys.readouterr().err.splitlines()[-1]
        assert line == f"foretouch {command}: error: argument {message}"

    cases = [
        ("record -o none --seconds -1", "--seconds: -1 is not above 0"),
        ("run --source none --count 0", "--count: 0 is not 1 or more"),
        ("replay none --rate fast", "--rate: 'fast' is not a finite number"),
        ("train none -o none --workers 2.5", "--workers: '2.5' is not a whole number"),
        ("run --source none --plane 0,0,1", "--plane: '0,0,1' is not 4 numbers with commas between them"),
        ("replay none --plane x,0,1,1", "--plane: 'x,0,1,1' is not 4 numbers with commas between them"),
        *(
            (f"run --source none --serve {one}", f"--serve: {one!r} is not HOST:PORT, such as 127.0.0.1:8765")
            for one in ("8765", "localhost:", "127.0.0.1:99999", "127.0.0.1:x")
        ),
    ]
    every_case(cases, check)

    def check_setting(name: str, text: str) -> None:
        command, option = name.split()
        call(command, files / "object.pcd", option, text).check_refused(CHECKED_LATER[name])

    settings = {"grasp --tip-mm": ("nan", "-5", "0"), "grasp --count": ("-5", "0"), "grasp --slide-m": ("nan", "inf")}
    every_case([(name, text) for name, texts in settings.items() for text in texts], check_setting)
