# SPDX-License-Identifier: Apache-2.0
"""`foretouch dataset`: what recordings hold, whether they are whole, and the ways in and out."""

from __future__ import annotations

import argparse
from pathlib import Path

from foretouch.tactile.messages import TACTILE_TYPES
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC, TACTILE_TOPIC, full_name

__all__ = ["add_arguments", "run"]

_SHEET_SAMPLES = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One action each, with its own options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, (summary, add) in _ACTIONS.items():
        action = actions.add_parser(name, help=summary, description=f"{summary}.")
        add(action)
        action.add_argument("--json", action="store_true", help="JSON on stdout, and nothing else there")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 where something is damaged."""
    from foretouch.cli import dataset_look, dataset_make

    actions = {
        "info": dataset_look.info,
        "verify": dataset_look.verify,
        "show": dataset_look.show,
        "repair": dataset_make.repair,
        "edit": dataset_make.edit,
        "build": dataset_make.build,
        "import": dataset_make.import_,
        "export": dataset_make.export_,
    }
    return actions[arguments.action](arguments)


def _fingers(text: str) -> tuple[int, int]:
    """`TH,MF` places for argparse."""
    words = text.split(",")
    if len(words) != 2 or not all(word.isdecimal() and int(word) < 5 for word in words):
        raise argparse.ArgumentTypeError(f"{text!r} is not two places from 0 to 4 with a comma between them")
    return int(words[0]), int(words[1])


def _add_info(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="IN", help="dataset, recording, training store or vision2tactile folder")


def _add_paths(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("paths", metavar="IN", nargs="+", help="dataset or recording; verify takes training stores too")


def _add_build(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sources", metavar="IN", nargs="+", help="datasets, recordings, stores, vision2tactile folders")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="STORE", help="training store; must not exist")
    parser.add_argument("--seed", type=int, default=0, help="of the splits")


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SRC", help="vision2tactile folders, training store, rosbag2 or MCAP")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DS", help="dataset: made, or added to")
    topics = {"cloud": CLOUD_TOPIC, "grasp": GRASPS_TOPIC, "executed": EXECUTED_TOPIC, "tactile": TACTILE_TOPIC}
    for name, topic in topics.items():
        types = f"; types: {', '.join(TACTILE_TYPES)}" if name == "tactile" else ""
        text = f"of a bag without samples of foretouch (default: %(default)s){types}"
        parser.add_argument(f"--{name}-topic", default=full_name(topic), metavar="TOPIC", help=text)
    parser.add_argument("--thumb", default="", metavar="NAME", help="name of the thumb in the tactile messages")
    parser.add_argument("--middle", default="", metavar="NAME", help="name of the middle finger")
    parser.add_argument("--object", default="unknown", help="label of the object on the table")
    parser.add_argument("--fingers", type=_fingers, metavar="TH,MF", help="indices instead of names (default: 4,1)")
    for name in ("hand", "camera"):
        parser.add_argument(
            f"--{name}", action="append", default=[], metavar="NAME=VALUE", help="a fact of its identity"
        )


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="DS", help="dataset, recording, training store or vision2tactile folder")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder to be made")
    parser.add_argument("--format", required=True, choices=["vision2tactile", "npz", "rosbag2"])


def _add_show(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="DS", help="dataset, recording, training store or vision2tactile folder")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="F.png", help="the picture")
    parser.add_argument("-n", "--count", type=int, default=_SHEET_SAMPLES, help="samples, spread over the whole")
    parser.add_argument("--id", action="append", metavar="ID", help="a sample, instead of --count")


def _add_edit(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="DS", help="dataset; without an action, its edits are listed")
    parser.add_argument("--id", action="append", default=[], metavar="ID", help="a sample, for --relabel and --drop")
    actions = parser.add_mutually_exclusive_group()
    actions.add_argument("--relabel", metavar="LABEL", help="give the samples another object")
    actions.add_argument("--drop", action="store_true", help="discard the samples: they go no further")
    actions.add_argument("--merge", nargs=2, metavar=("LABEL", "INTO"), help="make one object of two")
    actions.add_argument("--undo", action="store_true", help="take back the latest edit that holds")


_ACTIONS = {
    "info": ("Count what a dataset holds", _add_info),
    "verify": ("Prove that every byte is what was written", _add_paths),
    "repair": ("Make whole recordings of unfinished or damaged ones; the originals are kept", _add_paths),
    "edit": ("Relabel, drop or merge samples in a log beside the recordings; can be undone", _add_edit),
    "build": ("Build a training store, splits included", _add_build),
    "import": ("Make a dataset of what others recorded", _add_import),
    "export": ("Write samples in another format", _add_export),
    "show": ("Draw a contact sheet: clouds, contacts and electrode maps", _add_show),
}
