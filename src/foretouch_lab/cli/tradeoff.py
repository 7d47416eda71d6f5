# SPDX-License-Identifier: Apache-2.0
"""`foretouch tradeoff AREA`: measure skill and time of many settings, and name those on the frontier."""

import argparse

from foretouch.cli.parser import CommandParser
from foretouch_lab.cli.experiment import add_sweep_arguments, print_list, run_experiment
from foretouch_lab.experiments.framework.tradeoff import find_area, list_areas


def add_arguments(parser: CommandParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("area", metavar="AREA", help="model, or another area; `list` prints all")
    add_sweep_arguments(parser, "small", "small (default): within 3 minutes, trains no network; full: all settings")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a skill could not be measured."""
    if arguments.area == "list":
        return print_list("areas", {area.area: area for area in list_areas()}, as_json=arguments.json)
    return run_experiment(find_area(arguments.area), arguments)
