# SPDX-License-Identifier: Apache-2.0
"""`foretouch replay`: play a recording or a folder into a graph that runs elsewhere, in place of a camera."""

import argparse
from typing import TYPE_CHECKING, cast

from foretouch.cli.inputs import depth_camera
from foretouch.cli.output import print_json, warn
from foretouch.cli.parser import CommandParser
from foretouch.cli.run import add_replay_arguments, replay_fault, source_parameters
from foretouch.errors import ConfigError
from foretouch.ros.graph import Graph

if TYPE_CHECKING:
    from foretouch.ros.nodes.replay import ReplayNode


def add_arguments(parser: CommandParser) -> None:
    """Declare the options."""
    parser.add_argument("path", metavar="PATH", help="a recording, a folder of clouds or samples, or a file")
    add_replay_arguments(parser, "recorded times; 10 for files")
    parser.add_argument("--loop", action="store_true", help="start again at the end, until Ctrl-C")
    parser.add_argument("--restamp", action="store_true", help="stamp each message with the time it is published")
    parser.add_argument("--no-wait", action="store_true", help="play even without subscribers")


def run(arguments: argparse.Namespace) -> int:
    """Return exit status 1 if the replay could not start or failed."""
    from foretouch.dataset.source import open_source
    from foretouch.ros.sessions.playlist import cloud_is_object

    # So that an absent one is reported before anything starts.
    source = open_source(arguments.path, arguments.topic, camera=depth_camera(arguments))
    if arguments.plane is not None and not cloud_is_object(source):
        raise ConfigError(f"--plane: is for the points of one object; the table is found in {arguments.path}")
    parameters = source_parameters(arguments, arguments.path)
    parameters |= {"loop": arguments.loop, "restamp": arguments.restamp}
    if arguments.no_wait:
        parameters["subscribers"] = 0
    with Graph({"replay": parameters}, namespace=arguments.namespace) as graph:
        graph.require_active()
        replay = cast("ReplayNode", graph.nodes["replay"])
        try:
            replay.ended.wait()
        except KeyboardInterrupt:
            replay.stop()
        counts = {
            "outcome": replay.outcome,
            "clouds": graph.played(),
            "unreadable": replay.unreadable,
            "played": dict(replay.played),
            "conflicts": graph.conflicts(),
        }
        if arguments.json:
            print_json(counts)
        else:
            warn(f"{arguments.path}: {replay.outcome}, {graph.played()} clouds played")
        if fault := replay_fault(replay):
            warn(f"{arguments.path}: {fault}")
        return int(bool(fault))
