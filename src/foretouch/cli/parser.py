# SPDX-License-Identifier: Apache-2.0
"""The parser of every command: help with defaults, groups, an example and exit statuses; refusals with the nearest word."""

import argparse
import re
import shutil
import textwrap
from itertools import pairwise
from typing import Any, Final

from foretouch.errors import ForetouchError, nearest, none_of

_GROUPS: Final = {
    "what is read": "topic intrinsics camera_info info_topic rectified depth_scale color mask target pixel point plane scene hand grasp data here source dwell rate loop restamp resume "
    "sensor thumb middle check assume_grasps object objects",
    "model and adaptation": "model predictor tare touched history prequential tip_mm slide_m vary",
    "settings": "config set params namespace count seconds samples seed workers preset address explain wait_for "
    "wait_limit no_wait",
    "what is written": "all json out output picture panels serve save screenshot labels_out no_sheet redraw",
}
"""Names of options by the heading under which help lists them."""

_SETTINGS: Final = {"count": "grasp.count=K"}
"""Settings that some commands have as an option, and others with --set."""

_NARROWEST: Final = 20  # columns of help, however narrow the terminal says that it is

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
    "dataset info": "foretouch dataset info session",
    "dataset verify": "foretouch dataset verify session",
    "dataset repair": "foretouch dataset repair session/session-0001.mcap",
    "dataset edit": "foretouch dataset edit session --relabel cup --id can/000003",
    "dataset import": "foretouch dataset import vision2tactile -o grasps",
    "dataset export": "foretouch dataset export session -o arrays --format npz",
    "dataset show": "foretouch dataset show session -o sheet.png",
    "sensor list": "foretouch sensor list",
    "sensor check": "foretouch sensor check my_sensor.yaml",
    "sensor show": "foretouch sensor show biotac_sp -o taxels.png",
    "hand list": "foretouch hand list",
    "hand check": "foretouch hand check my_gripper.yaml --urdf my_gripper.urdf -o over.png",
    "hand show": "foretouch hand show franka_hand -o hand.png",
}
"""Example command lines for the help of foretouch itself and of actions. `foretouch.cli.commands` holds the examples of commands."""


class CommandParser(argparse.ArgumentParser):
    """A parser whose help and refusals are the same for all commands.

    Attributes:
        commands: Parsers of its commands, or of the actions of a command, by name.
        faults: Why an action that was asked for cannot be used, by name.
        declared: Its arguments and options, without `--help`.
        headings: Groups of options in its help, by title.
    """

    def __init__(self, example: str = "", **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, add_help=False, **options)
        super().add_argument("-h", "--help", action="help", help="print this help and end")
        self.commands: dict[str, CommandParser] = {}
        self.faults: dict[str, ForetouchError] = {}
        self.declared: list[argparse.Action] = []
        self._choice: Any = None
        self.headings = {title: self.add_argument_group(title) for title in _GROUPS}
        name = self.prog.partition(" ")[2]
        width = max(shutil.get_terminal_size().columns - 4, _NARROWEST)
        statuses = textwrap.wrap(STATUSES + _MORE_STATUSES.get(name, ""), width)
        self.epilog = "\n".join(
            ["example:", f"  {example or EXAMPLES[name]}", "", "exit status:", *(f"  {line}" for line in statuses)]
        )

    def add_argument(self, *names: str, group: Any = None, **options: Any) -> argparse.Action:
        """Declare an argument or option, with its default in the help.

        Args:
            names: Name of an argument, or names of an option.
            group: Group that it belongs to; by default the heading of its name.
            options: What `argparse` takes for it.
        """
        if names[0].startswith("-"):
            options["help"] = _with_default(options)
        add = self._heading(names[-1]).add_argument if group is None else group.add_argument
        action: argparse.Action = add(*names, **options)
        self.declared.append(action)
        return action

    def _heading(self, name: str) -> Any:
        """Return the group under which an option stands, or what takes all others."""
        key = name.lstrip("-").replace("-", "_")
        for title, names in _GROUPS.items():
            if name.startswith("-") and key in names.split():
                return self.headings[title]
        return super()

    def add_json(self) -> None:
        """Add the option that nearly all commands have."""
        help_text = "print JSON on stdout, an object a line, and nothing else there"
        self.add_argument("--json", action="store_true", help=help_text)

    def add_command(self, name: str, summary: str, example: str = "") -> "CommandParser":
        """Add a command, or an action of a command, whose name is then `command` or `action` of the arguments.

        Args:
            name: Of the command or action.
            summary: Its line in the help.
            example: A command line for its own help; by default the one of `EXAMPLES`.
        """
        if self._choice is None:
            kind = "action" if " " in self.prog else "command"
            self._choice = self.add_subparsers(dest=kind, metavar=kind.upper(), required=kind == "action")
        plain = summary.replace("%", "%%")  # argparse fills in what follows a %
        self.commands[name] = self._choice.add_parser(
            name, help=plain, description=f"{plain}.", example=example.replace("%", "%%")
        )
        return self.commands[name]

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, after misspelled options and commands are refused: argparse complains of what is absent first.

        Numbers that begin below 0, as in `--point -0.1,0,1`, are joined to their option: argparse takes them for one.
        """
        words: list[str] = []
        for word in args or ():
            if words and re.match(r"-[.\d]+[^,]*,", word) and re.fullmatch(r"--\w[\w-]*", words[-1]):
                words[-1] += f"={word}"
            else:
                words.append(word)
        if self.commands:
            chosen = next((word for word in words if not word.startswith("-")), None)
            if chosen in self.faults:
                raise self.faults[chosen]
            if chosen is not None and chosen not in self.commands:
                self.error(f"{none_of(chosen, self.commands)}")
        else:
            self._check_options(words)
        return super().parse_known_args(words, namespace)

    def _check_options(self, words: list[str]) -> None:
        known = [name for action in self.declared for name in action.option_strings]
        for before, word in pairwise(["", *words]):
            if not word or re.fullmatch(r"--\w[\w-]*=", word):
                name = next((text for text in (word.rstrip("="), before) if text.startswith("-")), "an argument")
                self.error(f"{name}: is empty; give a value, or leave it out")
        for word in words[: words.index("--")] if "--" in words else words:
            option = word.partition("=")[0]
            if re.match(r"--\w", word) and not any(name.startswith(option) for name in ("--help", *known)):
                setting = _SETTINGS.get(option.lstrip("-")) if "--set" in known else None
                cure = f"; give --set {setting}" if setting else nearest(option, known, 0.6)  # the dashes are alike
                self.error(f"{option}: there is no such option{cure}")


def one_of(*known: str) -> Any:
    """Return a type for `add_argument` that refuses other words, with the nearest known one."""

    def word(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(none_of(text, known))
        return text

    return word


def _with_default(options: dict[str, Any]) -> str:
    """Return the help of an option with its default, if it takes a value and does not say it."""
    text = str(options.get("help", ""))
    if options.get("action", "append") != "append" or "default" in text or "required" in text:
        return text
    if options.get("required"):
        return f"{text} (required)"
    return f"{text} (default: {'none' if options.get('default') in (None, [], '') else '%(default)s'})"
