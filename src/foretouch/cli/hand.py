# SPDX-License-Identifier: Apache-2.0
"""`foretouch hand`: list, check and draw descriptions of hands and grippers."""

import argparse
from pathlib import Path
from typing import Any

from foretouch.cli.inputs import error_line
from foretouch.cli.output import print_json, print_table, warn
from foretouch.cli.parser import CommandParser
from foretouch.errors import ForetouchError
from foretouch.files import PICTURE_SUFFIXES, require_writable
from foretouch.grasp.hand import hand_files, load_hand


def add_arguments(parser: CommandParser) -> None:
    """One action each."""
    for name, summary, count in (
        ("list", "List the hands of the package", 0),
        ("check", "Check descriptions of hands", "+"),
        ("show", "Draw the boxes of a hand, open and closed", 1),
    ):
        action = parser.add_command(name, summary)
        action.add_json()
        if count:
            about = "YAML file, or the name of a hand of the package"
            action.add_argument("hands", metavar="HAND", nargs=count, help=about)
        if name == "show":
            action.add_argument("-o", "--out", type=Path, required=True, metavar="F.png", help="image file")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a description breaks a rule."""
    if arguments.action == "show":
        from foretouch.report.hand_figure import save_hand_figure

        require_writable(arguments.out, *PICTURE_SUFFIXES)
        save_hand_figure(load_hand(arguments.hands[0]), arguments.out)
    records = [_record(name) for name in (hand_files() if arguments.action == "list" else arguments.hands)]
    found = [record for record in records if record["status"] == "ok"]
    for record in records if arguments.json else ():
        print_json(record)
    if found and not arguments.json:
        columns = ["hand", "opens [mm]", "deep [mm]", "tool frame", "joints", "what it is"]
        print_table("Hands", columns, [_row(record) for record in found])
    for record in records:
        if record["status"] != "ok":
            warn(record["reason"])
    return int(len(found) < len(records))


def _record(name: str) -> dict[str, Any]:
    """The JSON object of a hand."""
    try:
        hand = load_hand(name)
    except ForetouchError as err:
        return {"input": name, "status": "refused", "reason": error_line(name, err)}
    config = hand.config
    return {
        "input": name,
        "status": "ok",
        "name": config.name,
        "summary": config.summary,
        "opening_m": config.opening_m,
        "depth_m": [float(hand.depths.min()), float(hand.depths.max())] if hand.limits_depth else None,
        "tool": config.tool,
        "joints": [joint.name for joint in config.joints],
        "boxes": hand.names,
    }


def _row(record: dict[str, Any]) -> list[str]:
    least, most = (f"{1e3 * one:.0f}" for one in record["depth_m"] or (float("inf"), float("inf")))
    depth = least if least == most else f"{least} to {most}"
    numbers = [f"{1e3 * record['opening_m']:.0f}", depth, record["tool"], str(len(record["joints"]))]
    return [record["name"], *numbers, record["summary"]]
