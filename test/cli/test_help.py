# SPDX-License-Identifier: Apache-2.0
"""The help of every command: an example that can be typed, defaults, groups, exit statuses; and refusals of words."""

import argparse
import re
import shlex

import pytest
from every_case import every_case

from foretouch.cli.main import COMMANDS, _parser, main
from foretouch.cli.parser import EXAMPLES

ACTIONS = {
    "dataset": ("info", "verify", "repair", "edit", "build", "import", "export", "show"),
    "sensor": ("list", "check", "show"),
}


def parser_of(name: str) -> argparse.ArgumentParser:
    parser = _parser(name.partition(" ")[0] or None)
    for word in name.split():
        (commands,) = (one for one in parser._actions if isinstance(one, argparse._SubParsersAction))
        parser = commands.choices[word]
    return parser


def test_the_help_of_every_command_has_an_example_defaults_groups_and_exit_statuses(monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    names = ["", *COMMANDS, *(f"{name} {action}" for name, actions in ACTIONS.items() for action in actions)]
    assert set(names) == set(EXAMPLES)

    def check(name: str) -> None:
        parser, text = parser_of(name), parser_of(name).format_help()
        assert max(map(len, text.splitlines())) <= 80
        assert re.search(r"exit status:\n  0 done; 1 .*; 2 wrong", text)
        example = EXAMPLES[name]
        assert f"example:\n  {example[:60]}" in text
        words = shlex.split(example)
        assert words[: 1 + len(name.split())] == ["foretouch", *name.split()]
        _parser(words[1]).parse_args(words[1:])  # or argparse ends the process
        options = [one for one in parser._actions if one.option_strings and one.dest not in {"help", "version"}]
        flat = " ".join(text.split())
        for option in options:
            entry = flat.partition(f" {option.option_strings[-1]} ")[2]
            assert entry, option.dest
            if option.nargs != 0 and not option.required:
                shown = parser._get_formatter()._get_help_string(option)
                assert re.search("default|required", shown), option.dest
        if len(options) > 10:
            titles = re.findall(r"^([a-z].*):$", text, re.MULTILINE)
            assert len(titles) >= 4, titles
            others = text.partition("others:\n")[2].partition("\n\n")[0]
            assert not others or others.split()[:2] == ["-h,", "--help"], others
            assert others.count("\n") == 0, others

    every_case(names, check)


def test_words_that_are_misspelled_are_usage_errors_with_the_nearest_one(capsys) -> None:
    cases = (
        ("evalute default store", "'evalute' is not one of segment, ", "did you mean evaluate?"),
        ("dataset infoo store", "'infoo' is not one of info, ", "did you mean info?"),
        ("run --sorce scene.yaml", "--sorce: there is no such option", "did you mean --source?"),
        ("run --source x --pictrue y.png", "--pictrue: there", "did you mean --picture?"),
        ("predict x.pcd --modle touchnet-v1", "--modle: there", "did you mean --model?"),
        ("train contact-v2 --wrokers 2", "--wrokers: there", "did you mean --workers?"),
        ("grasp x.pcd --target nearst", "'nearst' is not one of nearest, ", "did you mean nearest?"),
        ("dataset export store -o x --format numpy", "'numpy' is not one of ", "npz"),
    )

    def check(line: str, *texts: str) -> None:
        with pytest.raises(SystemExit) as ended:
            main(line.split())
        assert ended.value.code == 2
        err = capsys.readouterr().err
        assert all(text in err for text in texts), err

    every_case(cases, check)
