# SPDX-License-Identifier: Apache-2.0
"""`foretouch hand`: list, check and draw descriptions of hands and grippers."""

import argparse
from pathlib import Path
from typing import Any

from foretouch.cli.descriptions import Descriptions
from foretouch.cli.parser import CommandParser
from foretouch.grasp.hand import hand_files, load_hand


def add_arguments(parser: CommandParser) -> None:
    """Add an action for each thing to do with a description."""
    _HANDS.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run an action; the exit status is 1 if a description breaks a rule."""
    return _HANDS.run(arguments)


def _facts(name: str) -> dict[str, Any]:
    hand = load_hand(name)
    config = hand.config
    return {
        "name": config.name,
        "summary": config.summary,
        "opening_m": config.opening_m,
        "depth_m": [float(hand.depths.min()), float(hand.depths.max())] if hand.limits_depth else None,
        "tool": config.tool,
        "joints": [joint.name for joint in config.joints],
        "boxes": hand.names,
    }


def _row(record: dict[str, Any]) -> list[str]:
    least, most = (f"{1e3 * depth:.0f}" for depth in record["depth_m"] or (float("inf"), float("inf")))
    depth = least if least == most else f"{least} to {most}"
    numbers = [f"{1e3 * record['opening_m']:.0f}", depth, record["tool"], str(len(record["joints"]))]
    return [record["name"], *numbers, record["summary"]]


def _save_figure(name: str, path: Path) -> None:
    from foretouch.report.hand_figure import save_hand_figure

    save_hand_figure(load_hand(name), path)


_HANDS = Descriptions(
    name="hand",
    show="Draw the boxes of a hand, open and closed",
    title="Hands",
    columns=["hand", "opens [mm]", "deep [mm]", "tool frame", "joints", "what it is"],
    files=hand_files,
    facts=_facts,
    row=_row,
    save_figure=_save_figure,
)
