# SPDX-License-Identifier: Apache-2.0
"""`foretouch forget`: let a running graph forget readings, where there is no `ros2 service call`."""

import argparse

from foretouch.cli.inputs import add_options, positive_value
from foretouch.cli.output import print_json
from foretouch.cli.parser import CommandParser, one_of
from foretouch.ros.graph import call_trigger


def add_arguments(parser: CommandParser) -> None:
    """Declare what is forgotten, and by which graph."""
    text = "touches: the readings of the current object, after it was replaced; history: all readings of the hand"
    parser.add_argument("what", metavar="touches|history", type=one_of("touches", "history"), help=text)
    add_options(parser, "--namespace")
    parser.add_argument("--wait", type=positive_value, default=5.0, metavar="S", help="longest wait for the graph [s]")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if there is no graph, or it does not answer."""
    success, message = call_trigger(f"forget_{arguments.what}", arguments.namespace, arguments.wait)
    if arguments.json:
        print_json({"forgotten": arguments.what, "success": success, "message": message})
    else:
        print(message)
    return int(not success)
