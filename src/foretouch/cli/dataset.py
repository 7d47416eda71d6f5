# SPDX-License-Identifier: Apache-2.0
"""`foretouch dataset`: inspect, verify, repair, edit and convert datasets. The actions are in `dataset_actions`."""

import argparse
from pathlib import Path

from foretouch.cli.inputs import positive_number, seed_number
from foretouch.dataset.formats import export_formats, readable_formats
from foretouch.tactile.messages import TACTILE_TYPES
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC, TACTILE_TOPIC, full_name

_SHEET_SAMPLES = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add one action each, with its options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, (summary, add) in _ACTIONS.items():
        action = actions.add_parser(name, help=summary, description=f"{summary}.")
        add(action)
        action.add_argument("--json", action="store_true", help="print JSON on stdout, and nothing else there")


def run(arguments: argparse.Namespace) -> int:
    """Run an action; exit status 1 if something is damaged."""
    from foretouch.cli.dataset_actions import ACTIONS

    return ACTIONS[arguments.action](arguments)


def _fingers(text: str) -> tuple[int, int]:
    """`TH,MF` indices for argparse."""
    words = text.split(",")
    if len(words) != 2 or not all(word.isdecimal() and int(word) < 5 for word in words):
        raise argparse.ArgumentTypeError(f"{text!r} is not two indices from 0 to 4 with a comma between them")
    return int(words[0]), int(words[1])


def _dataset_argument(parser: argparse.ArgumentParser, name: str, metavar: str, nargs: str | None = None) -> None:
    parser.add_argument(name, metavar=metavar, nargs=nargs, help=f"dataset: {readable_formats()}")


def _out_argument(parser: argparse.ArgumentParser, metavar: str, summary: str) -> None:
    parser.add_argument("-o", "--out", type=Path, required=True, metavar=metavar, help=summary)


def _add_info(parser: argparse.ArgumentParser) -> None:
    _dataset_argument(parser, "path", "IN")


def _add_verify(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("paths", metavar="IN", nargs="+", help="recorded dataset, one of its files, or training store")


def _add_repair(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("paths", metavar="IN", nargs="+", help="recorded dataset, or one of its files")


def _add_build(parser: argparse.ArgumentParser) -> None:
    _dataset_argument(parser, "sources", "IN", nargs="+")
    _out_argument(parser, "STORE", "training store to create; must not exist")
    parser.add_argument("--seed", type=seed_number, default=0, help="random seed of the splits")


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SRC", help=f"dataset ({readable_formats()}) or ROS bag")
    _out_argument(parser, "DS", "recorded dataset to create or to extend")
    group = parser.add_argument_group("ROS bags without foretouch samples")
    for name, topic, content in (
        ("cloud", CLOUD_TOPIC, "clouds of the object"),
        ("grasp", GRASPS_TOPIC, "planned grasps"),
        ("executed", EXECUTED_TOPIC, "executed grasps"),
        ("tactile", TACTILE_TOPIC, f"tactile readings ({', '.join(TACTILE_TYPES)})"),
    ):
        text = f"topic of the {content} (default: %(default)s)"
        group.add_argument(f"--{name}-topic", default=full_name(topic), metavar="TOPIC", help=text)
    group.add_argument("--thumb", default="", metavar="NAME", help="name of the thumb in the tactile messages")
    group.add_argument("--middle", default="", metavar="NAME", help="name of the middle finger")
    group.add_argument("--object", default="unknown", help="label of the object on the table")
    group.add_argument(
        "--fingers", type=_fingers, metavar="TH,MF", help="indices of both fingers instead of names (default: 4,1)"
    )
    for name in ("hand", "camera"):
        parser.add_argument(
            f"--{name}", action="append", default=[], metavar="NAME=VALUE", help=f"a property of the {name}"
        )


def _add_export(parser: argparse.ArgumentParser) -> None:
    _dataset_argument(parser, "source", "DS")
    _out_argument(parser, "DIR", "folder to create; must not exist")
    parser.add_argument("--format", required=True, choices=export_formats(), help="format to write")


def _add_show(parser: argparse.ArgumentParser) -> None:
    _dataset_argument(parser, "source", "DS")
    _out_argument(parser, "F.png", "image file")
    parser.add_argument(
        "-n",
        "--count",
        type=positive_number,
        default=_SHEET_SAMPLES,
        help="number of samples, evenly spaced over the dataset",
    )
    parser.add_argument("--id", action="append", metavar="ID", help="id of a sample to draw, instead of --count")


def _add_edit(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="DS", help="recorded dataset; without an action, its edits are listed")
    parser.add_argument(
        "--id", action="append", default=[], metavar="ID", help="id of a sample to relabel or drop; may be repeated"
    )
    actions = parser.add_mutually_exclusive_group()
    actions.add_argument("--relabel", metavar="LABEL", help="assign the samples to another object")
    actions.add_argument("--drop", action="store_true", help="discard the samples: builds and exports leave them out")
    actions.add_argument("--merge", nargs=2, metavar=("LABEL", "INTO"), help="merge two objects into one")
    actions.add_argument("--undo", action="store_true", help="undo the latest edit that is in force")


_ACTIONS = {
    "info": ("Print counts and ranges of a dataset", _add_info),
    "verify": ("Verify the checksums of every byte", _add_verify),
    "repair": ("Repair unfinished or damaged recordings, and keep the originals", _add_repair),
    "edit": ("Relabel, drop or merge samples in a log beside the recordings; can be undone", _add_edit),
    "build": ("Build a training store with splits", _add_build),
    "import": ("Convert other datasets and ROS bags to a recorded dataset", _add_import),
    "export": ("Write samples in another format", _add_export),
    "show": ("Draw a contact sheet: clouds, contacts and electrode maps", _add_show),
}
