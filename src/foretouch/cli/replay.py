# SPDX-License-Identifier: Apache-2.0
"""`foretouch replay`: play a recording or a folder into a graph that runs elsewhere, as if a camera did."""

from __future__ import annotations

import argparse

from foretouch.cli.output import print_json, warn
from foretouch.cli.run import replay_fault
from foretouch.errors import ForetouchError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to play, how fast, and where."""
    parser.add_argument("path", metavar="PATH", help="a recording, a folder of clouds or samples, or a file")
    parser.add_argument("--topic", help="which topic of a recording holds the clouds")
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="clouds a second (default: recorded times; 10 for files)"
    )
    parser.add_argument("--loop", action="store_true", help="begin anew at the end, until Ctrl-C")
    parser.add_argument("--restamp", action="store_true", help="stamp each message with the time it is published")
    parser.add_argument("--plane", metavar="a,b,c,d", help="table of clouds that hold one object each")
    parser.add_argument("--no-wait", action="store_true", help="play even if nobody listens")
    parser.add_argument("--namespace", help="of the graph (default: /foretouch)")
    parser.add_argument("--json", action="store_true", help="a last line with the counts")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if the replay could not begin or broke off."""
    from foretouch.cli.inputs import four_numbers
    from foretouch.ros.graph import Graph

    parameters = {"path": arguments.path, "loop": arguments.loop, "restamp": arguments.restamp}
    if arguments.topic:
        parameters["topic"] = arguments.topic
    if arguments.rate is not None:
        parameters["rate_hz"] = arguments.rate
    if arguments.plane:
        parameters["table"] = four_numbers(arguments.plane)
    if arguments.no_wait:
        parameters["subscribers"] = 0
    with Graph({"replay": parameters}, namespace=arguments.namespace) as graph:
        replay = graph.replay
        if replay is None or not graph.started:
            raise ForetouchError(f"{arguments.path}: the replay did not begin; its log tells why")
        try:
            replay.ended.wait()
        except KeyboardInterrupt:
            replay.stop()
        counts = {
            "outcome": replay.outcome,
            "clouds": graph.played(),
            "unreadable": replay.unreadable,
            "played": dict(replay.played),
        }
        if arguments.json:
            print_json(counts)
        else:
            warn(f"{arguments.path}: {replay.outcome}, {graph.played()} clouds played")
        fault = replay_fault(replay)
        if fault is not None:
            warn(f"{arguments.path}: {fault}")
        return int(fault is not None)
