# SPDX-License-Identifier: Apache-2.0
"""The parser of every command: help with defaults, groups, an example and exit statuses; refusals with the nearest word."""

import argparse
import re
from collections.abc import Iterable, Sequence
from typing import Any, Final

from foretouch.errors import nearest, none_of

_MANY: Final = 10  # options that need no groups
_GROUPS: Final = {
    "what is read": "topic intrinsics camera_info depth_scale mask target pixel point plane scene grasp data source dwell rate loop restamp resume "
    "sensor thumb middle check assume_grasps object objects",
    "model and adaptation": "model tare touched history prequential tip_mm slide_m vary",
    "settings": "config set params namespace count seconds samples seed workers preset address explain wait_for "
    "wait_limit no_wait",
    "what is written": "json out output picture serve save screenshot labels_out no_sheet redraw",
}
"""Destinations of options by the heading under which a command with many options lists them."""

STATUSES: Final = (
    "0 done; 1 a known failure, in one line that names what and why; 2 wrong usage; 128 + n ended by signal n"
)
_MORE_STATUSES: Final = {
    "run": "; 1 also if a cloud was not answered, none got a prediction, or the last grasp touched nothing; 3 if the camera never sent a cloud",
    "doctor": "; 1 also if something must be fixed",
    "models": "; 1 also if a model is damaged",
    "dataset verify": "; 1 also if a file is damaged",
}

EXAMPLES: Final = {
    "": "foretouch run --source config/scenes/clean.yaml",
    "segment": "foretouch segment scene.npz",
    "grasp": "foretouch grasp object.pcd --plane 0,0,1,-1.27",
    "predict": "foretouch predict object.pcd --touched session",
    "simulate": "foretouch simulate config/scenes/rigid.yaml -n 100 -o simulated",
    "dataset": "foretouch dataset info session",
    "dataset info": "foretouch dataset info session",
    "dataset verify": "foretouch dataset verify session",
    "dataset repair": "foretouch dataset repair session/session-0001.mcap",
    "dataset edit": "foretouch dataset edit session --relabel cup --id can/000003",
    "dataset build": "foretouch dataset build session simulated -o store",
    "dataset import": "foretouch dataset import vision2tactile -o grasps",
    "dataset export": "foretouch dataset export session -o arrays --format npz",
    "dataset show": "foretouch dataset show session -o sheet.png",
    "train": "foretouch train contact-v3 data=store -o can_model",
    "evaluate": "foretouch evaluate contact-v3 store --split object",
    "experiment": "foretouch experiment cross_validation -o out --preset quick",
    "tradeoff": "foretouch tradeoff model -o out",
    "run": "foretouch run --source config/scenes/clean.yaml --count 30 --picture touch.png",
    "record": "foretouch record -o session --object can --samples 20",
    "replay": "foretouch replay session --rate 5",
    "forget": "foretouch forget touches",
    "view": "foretouch view session --save session.rrd",
    "models": "foretouch models contact-v3",
    "sensor": "foretouch sensor list",
    "sensor list": "foretouch sensor list",
    "sensor check": "foretouch sensor check my_sensor.yaml",
    "sensor show": "foretouch sensor show biotac_sp -o taxels.png",
    "hand": "foretouch hand list",
    "hand list": "foretouch hand list",
    "hand check": "foretouch hand check my_gripper.yaml",
    "hand show": "foretouch hand show franka_hand -o hand.png",
    "doctor": "foretouch doctor --self-test",
}
"""A command line for the help of each command."""


class CommandParser(argparse.ArgumentParser):
    """A parser whose help and refusals are the same for all commands."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{"formatter_class": _Formatter, **options})

    def add_json(self) -> None:
        """Add the option that nearly all commands have."""
        help_text = "print JSON on stdout, an object a line, and nothing else there"
        self.add_argument("--json", action="store_true", help=help_text)

    def format_help(self) -> str:
        """Usage, description, arguments in groups, an example and the exit statuses."""
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for title, actions in self._sections():
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        name = self.prog.partition(" ")[2]
        for title, text in (("example", EXAMPLES[name]), ("exit status", STATUSES + _MORE_STATUSES.get(name, ""))):
            formatter.start_section(title)
            formatter.add_text(text)
            formatter.end_section()
        return formatter.format_help()

    def _sections(self) -> Iterable[tuple[str | None, Sequence[argparse.Action]]]:
        """Titles and arguments; more options than a few stand under several titles."""
        options = self._optionals._group_actions  # noqa: SLF001  argparse has no other way to list them
        for group in self._action_groups:
            if group is not self._optionals or len(options) <= _MANY + 1:  # beside --help
                yield group.title, group._group_actions  # noqa: SLF001
                continue
            left = list(options)
            for title, names in _GROUPS.items():
                found = [one for one in left if one.dest in names.split()]
                left = [one for one in left if one not in found]
                yield title, found
            yield "others", left

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse, which complains of what is absent before it looks at a misspelled option."""
        known = list(self._option_string_actions)
        for word in () if args is None or self._subparsers is not None else args:
            option = word.partition("=")[0]
            if word == "--":
                break
            if re.match(r"--\w", word) and not any(one.startswith(option) for one in known):
                self.error(f"{option}: there is no such option{nearest(option, known)}")
        return super().parse_known_args(args, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, none_of(value, action.choices))


class _Formatter(argparse.HelpFormatter):
    """Help with the default of every option that takes a value."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{"max_help_position": 26, **options})

    def _get_help_string(self, action: argparse.Action) -> str:
        text = action.help or ""
        if (
            not action.option_strings
            or action.nargs == 0
            or "default" in text
            or "required" in text
            or action.default is argparse.SUPPRESS
        ):
            return text
        if action.required:
            return f"{text} (required)"
        default = "none" if action.default is None or action.default in ([], "") else "%(default)s"
        return f"{text} (default: {default})"
