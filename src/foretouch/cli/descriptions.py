# SPDX-License-Identifier: Apache-2.0
"""What `foretouch hand` and `foretouch sensor` share: list, check and draw descriptions in YAML files."""

import argparse
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foretouch.base.files import PICTURE_SUFFIXES, require_writable
from foretouch.cli.inputs import error_line
from foretouch.cli.output import print_json, print_table, warn
from foretouch.cli.parser import CommandParser
from foretouch.errors import ForetouchError


@dataclass(frozen=True, kw_only=True)
class Descriptions:
    """A kind of descriptions, with its command.

    Args:
        name: Name of a description, such as `hand`; the plural ends with s.
        show: What `show` draws, as an imperative.
        title: Of the table.
        columns: Of the table.
        files: Gives the descriptions of the package, by name.
        facts: Reads a description by its name or file, and gives the fields of its JSON object.
        row: Gives the cells of the table from a JSON object.
        save_figure: Draws a description to a file.
    """

    name: str
    show: str
    title: str
    columns: list[str]
    files: Callable[[], Mapping[str, Path]]
    facts: Callable[[str], dict[str, Any]]
    row: Callable[[dict[str, Any]], list[str]]
    save_figure: Callable[[str, Path], Any]

    def add_arguments(self, parser: CommandParser) -> CommandParser:
        """Add the actions `list`, `check` and `show` to a parser; returns the parser of `check`."""
        made: dict[str, CommandParser] = {}
        for name, summary, count in (
            ("list", f"List the {self.name}s of the package", 0),
            ("check", f"Check descriptions of {self.name}s", "+"),
            ("show", self.show, 1),
        ):
            made[name] = parser.add_command(name, summary)
            made[name].add_json()
            if count:
                about = f"YAML file, or the name of a {self.name} of the package"
                made[name].add_argument("descriptions", metavar=self.name.upper(), nargs=count, help=about)
        made["show"].add_argument("-o", "--out", type=Path, required=True, metavar="F.png", help="image file")
        return made["check"]

    def run(self, arguments: argparse.Namespace) -> int:
        """Run an action; the exit status is 1 if a description breaks a rule."""
        if arguments.action == "list":
            return self._print(self.files(), arguments.json)
        if arguments.action == "show":
            require_writable(arguments.out, *PICTURE_SUFFIXES)
            self.save_figure(arguments.descriptions[0], arguments.out)
        return self._print(arguments.descriptions, arguments.json)

    def _print(self, names: Iterable[str], as_json: bool) -> int:
        records = [self._record(name) for name in names]
        read = [record for record in records if record["status"] == "ok"]
        if as_json:
            for record in records:
                print_json(record)
        elif read:
            print_table(self.title, self.columns, [self.row(record) for record in read])
        for record in records:
            if record["status"] != "ok":
                warn(record["reason"])
        return int(len(read) < len(records))

    def _record(self, name: str) -> dict[str, Any]:
        """Make the JSON object of a description."""
        try:
            return {"input": name, "status": "ok", **self.facts(name)}
        except ForetouchError as err:
            return {"input": name, "status": "refused", "reason": error_line(name, err)}
