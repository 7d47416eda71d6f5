# SPDX-License-Identifier: Apache-2.0
"""`foretouch hand`: list, check and draw descriptions of hands and grippers."""

import argparse
import math
from functools import partial
from pathlib import Path
from typing import Any

from foretouch.base.files import PICTURE_SUFFIXES, require_writable
from foretouch.cli.descriptions import Descriptions
from foretouch.cli.inputs import positive_value
from foretouch.cli.parser import CommandParser
from foretouch.doors import FUNCTIONS
from foretouch.errors import ConfigError
from foretouch.grasp.hand import hand_files, load_hand


def add_arguments(parser: CommandParser) -> None:
    """Add an action for each thing to do with a description."""
    check = _HANDS.add_arguments(parser)
    real = check.add_mutually_exclusive_group()
    about = "mesh of the real hand (OBJ, PLY, STL, GLB, DAE) in the tool's frame, to compare the boxes with"
    check.add_argument("--mesh", group=real, type=Path, metavar="F", help=about)
    about = "URDF of the real hand, without macros of xacro, to compare the boxes with"
    check.add_argument("--urdf", group=real, type=Path, metavar="F", help=about)
    check.add_argument("--unit", choices=("m", "mm"), default="m", help="unit of the mesh")
    about = "width of the grasp at which the boxes are compared (default: the first of the description)"
    check.add_argument("--width", type=partial(positive_value, or_zero=True), metavar="M", help=about)
    check.add_argument(
        "--link", metavar="NAME", help="link of the URDF that is the tool's frame (default: as described)"
    )
    check.add_argument("--links", nargs="+", default=[], metavar="NAME", help="compare these links of the URDF alone")
    about = "values of joints that the description does not state [rad] or [m]; others are 0"
    check.add_argument("--joints", nargs="+", type=_joint, default=[], metavar="NAME=VALUE", help=about)
    check.add_argument("-o", "--out", type=Path, metavar="F.png", help="draw the boxes over the surface")


def run(arguments: argparse.Namespace) -> int:
    """Run an action; the exit status is 1 if a description breaks a rule."""
    if arguments.action != "check" or not _compares(arguments):
        return _HANDS.run(arguments)
    if arguments.out is not None:
        require_writable(arguments.out, *PICTURE_SUFFIXES)
    option = "mesh" if arguments.urdf is None else "urdf"
    return int(FUNCTIONS.call("compare_hand", f"hand check --{option}", arguments))


def _compares(arguments: argparse.Namespace) -> bool:
    """Whether a description is compared with a real hand; refuse options that would have no effect."""
    for_urdf = {"--link": arguments.link, "--links": arguments.links, "--joints": arguments.joints}
    others = {"--unit": arguments.unit != "m", "--width": arguments.width is not None, "--out": arguments.out}
    if arguments.urdf is None and (vain := [name for name, given in for_urdf.items() if given]):
        raise ConfigError(f"{', '.join(vain)}: needs --urdf")
    if arguments.urdf is None and arguments.mesh is None:
        if vain := [name for name, given in others.items() if given]:
            raise ConfigError(f"{', '.join(vain)}: needs --mesh or --urdf")
        return False
    if arguments.urdf is not None and arguments.unit != "m":
        raise ConfigError("--unit: is for --mesh; a URDF is in metres, and states the scale of each of its meshes")
    if len(arguments.descriptions) > 1:
        raise ConfigError(f"{' '.join(arguments.descriptions)}: --mesh and --urdf are compared with one description")
    if arguments.width is not None and arguments.width > 1.0:
        raise ConfigError(f"--width: {arguments.width:g} is wider than any hand opens: is it in mm?")
    return True


def _joint(text: str) -> tuple[str, float]:
    """Return name and value of a joint for argparse."""
    name, _, value = text.partition("=")
    try:
        angle = float(value)
    except ValueError:
        angle = math.nan
    if not name or not math.isfinite(angle):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE with a finite number")
    return name, angle


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
